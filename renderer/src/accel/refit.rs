//! Moving a tree along with its triangles.

use super::{Accel, EMPTY, LEAF, WIDTH};
use glam::Vec3A;

impl Accel {
    /// Gives the triangles, in the order given to [`Self::build`], new corners and fits the boxes to them; which triangles stand together
    /// stays as it was. Corners as for [`Self::build`].
    ///
    /// # Panics
    /// When there are not as many triangles as there were.
    pub fn refit(&mut self, triangles: &[[Vec3A; 3]]) {
        assert_eq!(triangles.len(), self.triangle_count(), "a tree can only be refitted to its own triangles");
        for leaf in &mut self.leaves {
            for (lane, &primitive) in leaf.primitives.iter().enumerate().filter(|(_, p)| **p != EMPTY) {
                for (corner, position) in triangles[primitive as usize].iter().enumerate() {
                    for axis in 0..3 {
                        leaf.vertices[corner][axis][lane] = position[axis];
                    }
                }
            }
        }
        // As the builder pads boxes.
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for corner in triangles.iter().flatten() {
            (low, high) = (low.min(*corner), high.max(*corner));
        }
        let padding = Vec3A::splat(low.abs().max(high.abs()).max_element() * 2f32.powi(-22));
        // Children follow their parents.
        let mut boxes = vec![(Vec3A::INFINITY, Vec3A::NEG_INFINITY); self.nodes.len()];
        for index in (0..self.nodes.len()).rev() {
            let node = &mut self.nodes[index];
            let mut own = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
            for lane in 0..WIDTH {
                let child = node.children[lane];
                if child == EMPTY {
                    continue;
                }
                let (low, high) = if child & LEAF == 0 {
                    boxes[child as usize]
                } else {
                    let leaf = &self.leaves[(child & !LEAF) as usize];
                    let used = (0..WIDTH).filter(|&lane| leaf.primitives[lane] != EMPTY);
                    used.flat_map(|lane| leaf.corners(lane))
                        .fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
                };
                own = (own.0.min(low), own.1.max(high));
                let (low, high) = ((low - padding).to_array(), (high + padding).to_array());
                for axis in 0..3 {
                    node.bounds[axis][0][lane] = low[axis];
                    node.bounds[axis][1][lane] = high[axis];
                }
            }
            boxes[index] = own;
        }
    }

    /// Boxes and leaves that a random ray through the tree is expected to meet (surface area heuristic); 0 for an empty tree.
    pub fn cost(&self) -> f64 {
        let area = |bounds: &[[glam::Vec4; 2]; 3], lane: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(bounds[axis][1][lane]) - f64::from(bounds[axis][0][lane]));
            x * y + y * z + z * x
        };
        let lanes = |node: &super::Node| {
            let used = (0..WIDTH).filter(|&lane| node.children[lane] != EMPTY);
            used.map(|lane| area(&node.bounds, lane)).collect::<Vec<f64>>()
        };
        let Some(root) = self.nodes.first() else { return 0.0 };
        let whole: f64 = lanes(root).into_iter().sum();
        let sum: f64 = self.nodes.iter().flat_map(lanes).sum();
        if whole > 0.0 { sum / whole } else { 0.0 }
    }
}
