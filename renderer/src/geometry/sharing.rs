//! Which meshes get a tree of their own.

use crate::accel::Placement;
use renderflow_scenes::{Instance, Mesh};

/// Flattening up to this many triangles is always right: 30 MB, built in a quarter of a second.
const FLATTENED_TRIANGLES: usize = 1 << 18;
/// Beyond it, flattening may multiply the triangles of the meshes by this factor.
const FLATTENED_COPIES: usize = 2;
/// Whether instances of one mesh share a tree in object space or are flattened into the tree of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sharing {
    /// Flatten while all instances together have at most 2^18 triangles or twice as many as the meshes they use; beyond that,
    /// share the meshes whose copies would add most, one after the other, until what is left is within that limit.
    #[default]
    Automatic,
    /// Flatten everything.
    Never,
    /// Share every mesh, also those used once.
    Always,
}

/// Which meshes get a tree of their own. Those that deform do not: their triangles are at other places in each frame.
pub(super) fn shared_meshes(meshes: &[Mesh], instances: &[Instance], sharing: Sharing) -> Vec<bool> {
    let mut uses = vec![0usize; meshes.len()];
    for instance in instances {
        uses[instance.mesh] += 1;
    }
    let mut shared = vec![false; meshes.len()];
    match sharing {
        Sharing::Never => {}
        Sharing::Always => shared = uses.iter().zip(meshes).map(|(&u, mesh)| u > 0 && !mesh.deforms()).collect(),
        Sharing::Automatic => {
            let size = |m: usize| meshes[m].triangles.len();
            let unique: usize = (0..meshes.len()).filter(|&m| uses[m] > 0).map(size).sum();
            let limit = FLATTENED_TRIANGLES.max(FLATTENED_COPIES.saturating_mul(unique));
            let mut flattened: usize = (0..meshes.len()).map(|m| uses[m].saturating_mul(size(m))).sum();
            let mut order: Vec<usize> =
                (0..meshes.len()).filter(|&m| uses[m] > 1 && size(m) > 0 && !meshes[m].deforms()).collect();
            order.sort_by_key(|&m| (std::cmp::Reverse((uses[m] - 1).saturating_mul(size(m))), m));
            for m in order {
                if flattened <= limit {
                    break;
                }
                shared[m] = true;
                flattened -= uses[m] * size(m);
            }
        }
    }
    shared
}

/// Whether rays can be taken to the instance's object space at every frame.
pub(super) fn can_share(instance: &Instance) -> bool {
    instance.transforms.iter().all(|transform| Placement::new(0, 0, *transform).is_some())
}
