//! The mask of the frames of a clip that are given.

/// The mask of a clip, `[cells, latent frames, height, width]`. Each of the `cells` = s s channels stands for one pixel that a
/// latent pixel covers. Values are 1 where a frame is rendered and 0 where it is given; `known` says for each frame whether it is
/// given.
///
/// As in VACE's code, latent frame j of n takes the value of frame `floor((j + 1/2) T / n)` of T. In the paper's clips of five
/// frames these are the second and the fourth frame, so the mask does not show a given first frame. Only the inactive latents do.
pub fn mask_cells(known: &[bool], latent_frames: usize, cells: usize, plane: usize) -> Vec<f32> {
    let value = |j: usize| {
        let frame = (2 * j + 1) * known.len() / (2 * latent_frames.max(1));
        if known.get(frame).copied().unwrap_or(false) { 0.0 } else { 1.0 }
    };
    let channel: Vec<f32> = (0..latent_frames).flat_map(|j| std::iter::repeat_n(value(j), plane)).collect();
    channel.repeat(cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_show_the_nearest_frame() {
        let cells = |known: &[bool], n: usize| mask_cells(known, n, 1, 1);
        assert_eq!(cells(&[false; 5], 2), [1.0, 1.0]);
        // The second and the fourth frame of five.
        assert_eq!(cells(&[true, false, false, false, false], 2), [1.0, 1.0]);
        assert_eq!(cells(&[true, true, false, false, false], 2), [0.0, 1.0]);
        assert_eq!(cells(&[false, false, false, true, false], 2), [1.0, 0.0]);
        // Frames 1, 4 and 7 of nine, and the only frame of one.
        assert_eq!(cells(&[false, true, false, false, true, false, false, false, false], 3), [0.0, 0.0, 1.0]);
        assert_eq!(cells(&[true], 1), [0.0]);
        assert_eq!(mask_cells(&[true, true, false, false, false], 2, 3, 2), [0.0, 0.0, 1.0, 1.0].repeat(3));
    }
}
