//! Conversion between pictures in planes and tensors whose size is a multiple of a token.

use burn::tensor::{Device, Tensor, TensorData};

/// The size of pictures, and the size to which they are padded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Size {
    pub width: usize,
    pub height: usize,
    pub padded_width: usize,
    pub padded_height: usize,
}

impl Size {
    /// A size that is padded to multiples of `multiple`.
    pub fn new(width: usize, height: usize, multiple: usize) -> Self {
        Self { width, height, padded_width: width.next_multiple_of(multiple), padded_height: height.next_multiple_of(multiple) }
    }

    /// Frames `[3, height, width]` as a clip `[1, 3, frames, padded height, padded width]`. Padding repeats the last row and
    /// column.
    pub fn clip(&self, frames: &[&[f32]], device: &Device) -> Tensor<5> {
        let (h, w) = (self.padded_height, self.padded_width);
        let mut values = Vec::with_capacity(3 * frames.len() * h * w);
        for channel in 0..3 {
            for frame in frames {
                let plane = &frame[channel * self.width * self.height..][..self.width * self.height];
                for y in 0..h {
                    let row = &plane[y.min(self.height - 1) * self.width..][..self.width];
                    values.extend_from_slice(row);
                    values.extend(std::iter::repeat_n(row[self.width - 1], w - self.width));
                }
            }
        }
        Tensor::from_data(TensorData::new(values, [1, 3, frames.len(), h, w]), device)
    }

    /// Frames `[3, padded height, padded width]` as a clip, without padding.
    pub fn whole_clip(&self, frames: &[&[f32]], device: &Device) -> Tensor<5> {
        Self::new(self.padded_width, self.padded_height, 1).clip(frames, device)
    }

    /// One frame `[3, height, width]` from the values of a clip `[1, 3, frames, padded height, padded width]`.
    pub fn frame(&self, values: &[f32], frames: usize, frame: usize) -> Vec<f32> {
        let plane = self.padded_height * self.padded_width;
        let mut picture = Vec::with_capacity(3 * self.width * self.height);
        for channel in 0..3 {
            let plane = &values[(channel * frames + frame) * plane..][..plane];
            for row in plane.chunks_exact(self.padded_width).take(self.height) {
                picture.extend_from_slice(&row[..self.width]);
            }
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::to_vec;

    #[test]
    fn padding_is_removed_again() {
        let size = Size::new(5, 3, 4);
        assert_eq!((size.padded_width, size.padded_height), (8, 4));
        let frame = |first: f32| (0..3 * 5 * 3).map(|i| first + i as f32).collect::<Vec<f32>>();
        let frames = [frame(0.0), frame(100.0)];
        let clip = size.clip(&[&frames[0], &frames[1]], &Device::flex());
        assert_eq!(clip.dims(), [1, 3, 2, 4, 8]);
        let values = to_vec(clip);
        // In the second channel of the first frame, padding at the bottom right is the last pixel.
        assert_eq!(values[(2 * 4 + 3) * 8 + 7], 29.0);
        for (i, frame) in frames.iter().enumerate() {
            assert_eq!(&size.frame(&values, 2, i), frame);
        }
    }
}
