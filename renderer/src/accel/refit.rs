//! Moving the triangles of a tree that stays as it is.

use super::collapse::{LEAF_COST, padding};
use super::{Accel, EMPTY, LEAF};
use glam::Vec3A;

impl Accel {
    /// Moves the triangles: new boxes and leaves, the same tree. `triangles` are as many as the tree was built of, in the same
    /// order and within the same limits. It takes a fiftieth of the time of a build; [`Self::quality`] tells how much slower
    /// queries became.
    ///
    /// # Panics
    /// If the number of triangles is another one.
    pub fn refit(&mut self, triangles: &[[Vec3A; 3]]) {
        let cost = self.fit(triangles);
        self.cost = cost;
    }

    /// Expected cost of a ray that meets the scene's box, relative to that when the tree was built (surface area heuristic): 1
    /// after [`Self::build`], larger where moving triangles has made boxes overlap. A tree at 1.5 is worth building again if it
    /// is asked many rays.
    pub fn quality(&self) -> f32 {
        let ratio = self.cost / self.built_cost;
        if ratio.is_finite() { ratio } else { 1.0 }
    }

    /// Sets leaves and boxes; returns the cost of the tree.
    pub(super) fn fit(&mut self, triangles: &[[Vec3A; 3]]) -> f32 {
        assert_eq!(triangles.len(), self.triangle_count(), "a tree is refitted to as many triangles as it was built of");
        let extent = triangles.iter().flatten().fold(Vec3A::ZERO, |m, corner| m.max(corner.abs()));
        let padding = padding([-extent, extent]);
        self.leaves.set_padding(padding.max_element(), extent.max_element());
        let half_area = |[low, high]: [Vec3A; 2]| {
            let d = high - low;
            f64::from(d.x * d.y + d.y * d.z + d.z * d.x)
        };
        // Of each node, unpadded. Children come after their parents.
        let mut bounds = vec![[Vec3A::INFINITY, Vec3A::NEG_INFINITY]; self.nodes.len()];
        let mut cost = 0.0;
        for index in (0..self.nodes.len()).rev() {
            let node = &mut self.nodes[index];
            let [mut low, mut high] = bounds[index];
            for lane in 0..node.children.len() {
                let child = node.children[lane];
                if child == EMPTY {
                    continue;
                }
                let inner = child & LEAF == 0;
                let own = if inner { bounds[child as usize] } else { self.leaves.set(child & !LEAF, triangles) };
                node.set_bounds(lane, own, padding);
                (low, high) = (low.min(own[0]), high.max(own[1]));
                cost += half_area(own) * if inner { 1.0 } else { f64::from(LEAF_COST) };
            }
            bounds[index] = [low, high];
        }
        bounds.first().map_or(0.0, |root| (cost / half_area(*root)) as f32)
    }
}
