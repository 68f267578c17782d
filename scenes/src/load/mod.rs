//! Loads everything a scene refers to, once each: environment, model files, textures, shapes, cameras of all frames.

mod build;
mod capture;
mod deform;
mod floor;
mod gltf;
mod images;
mod mesh;
mod model;
mod obj;
mod patterns;
mod play;
mod ply;
mod polygon;
mod view;

use crate::Texture;
use crate::error::{Error, Result};
use crate::loaded::Encoding;
use glam::{Affine3A, DAffine3, DVec3};
use std::path::Path;

pub use crate::model_format::Format;
pub use build::{load, load_everything};
pub use capture::Capture;
pub(crate) use model::{Extent, extent};
pub use model::{ModelView, describe_model};
pub use view::{Contents, animation_length, contents, look_through, play};

/// Reads an image file (PNG, JPEG or WebP, by content) as a texture that repeats.
///
/// # Errors
/// [`Error::Model`] when it cannot be read, with what is wrong with its bytes.
pub fn read_texture(path: &Path, encoding: Encoding) -> Result<Texture> {
    let bytes = crate::texture::read(path).map_err(|reason| Error::model(path, "", reason))?;
    let name = path.to_string_lossy().into_owned();
    crate::texture::decode(&bytes, name, encoding, Default::default()).map_err(|reason| Error::model(path, "", reason))
}

/// Does the transform, as single precision stores it, keep three dimensions? Its inverse, taken in double precision, has to be
/// finite in single precision: the determinant alone would underflow for a uniform scale of 1e-13.
fn invertible(transform: Affine3A) -> bool {
    let matrix = transform.matrix3.as_dmat3();
    let determinant = matrix.determinant();
    transform.is_finite() && determinant.is_normal() && matrix.inverse().as_mat3().is_finite()
}

/// The transform counted from `origin` instead of the world's zero, in single precision.
fn relative(transform: DAffine3, origin: DVec3) -> Affine3A {
    DAffine3 { translation: transform.translation - origin, ..transform }.as_affine3a()
}

#[cfg(test)]
mod tests {
    use super::model;
    use crate::tangents;
    use renderflow_frame::reach::Reach;
    use std::path::Path;

    /// Generated tangents against those that another program wrote into real files. (Suzanne and TwoSidedPlane have tangents
    /// too, with w = 1 on mirrored coordinates: their exporter did not follow the rule that these two files and glTF follow.)
    #[test]
    fn tangents_equal_those_of_real_files() {
        for name in ["Avocado", "BoomBoxWithAxes"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../shared/assets/gltf/pbr/{name}/{name}.gltf"));
            if !path.exists() {
                println!("skipped: {} is not there", path.display());
                return;
            }
            let (mut corners, mut close, mut same_sign) = (0.0, 0.0, 0.0);
            for mut stored in model::read(&path, &Reach::of(&path), None, false).unwrap().meshes {
                // Triangles without area in the texture have no tangent to compare.
                let uvs = stored.uvs.clone();
                let area = |[a, b, c]: [usize; 3]| (uvs[b] - uvs[a]).perp_dot(uvs[c] - uvs[a]).abs();
                stored.triangles.retain(|t| area(t.map(|i| i as usize)) > 1e-9);
                let mut made = crate::Mesh { tangents: vec![], ..stored.clone() };
                assert!(tangents::generate(&mut made, glam::Mat2::IDENTITY));
                assert_eq!(made.triangles.len(), stored.triangles.len());
                for (&i, &j) in made.triangles.iter().flatten().zip(stored.triangles.iter().flatten()) {
                    let (a, b) = (made.tangents[i as usize], stored.tangents[j as usize]);
                    assert!(a.truncate().dot(stored.normals[j as usize]).abs() < 1e-3, "{name}: a tangent leaves the surface");
                    corners += 1.0;
                    close += f64::from(u8::from(a.truncate().dot(b.truncate()) > 0.98));
                    same_sign += f64::from(u8::from(a.w == b.w));
                }
            }
            let shares = [close / corners, same_sign / corners];
            assert!(shares.iter().all(|&s| s > 0.99), "{name}: within 11.5 degrees and of the same handedness: {shares:?}");
        }
    }
}
