//! Header attributes of a frame file: writes and reads [`FrameInfo`], and writes the standard camera attributes for other tools.

use crate::camera::Camera;
use crate::{FrameInfo, channel};
use ::exr::meta::attribute::{AttributeValue, Chromaticities, Matrix4x4, Text};
use ::exr::meta::header::{Header, ImageAttributes, LayerAttributes};
use glam::{DVec3, Mat4, Vec3, Vec4};

const VERSION: &str = "renderflow/version";
const CONVENTIONS: &str = "renderflow/conventions";
const SCENE_HASH: &str = "renderflow/scene_hash";
const SCENE_FILES: &str = "renderflow/scene_files";
const SEED: &str = "renderflow/seed";
const EXPOSURE: &str = "renderflow/exposure";
const BSDF: &str = "renderflow/bsdf";
const SAMPLING: &str = "renderflow/sampling";
const LENS: &str = "renderflow/lens";
const SHUTTER: &str = "renderflow/shutter";
const MAX_BOUNCES: &str = "renderflow/max_bounces";
const BRANCHES: &str = "renderflow/branches";
const INDIRECT_LIMIT: &str = "renderflow/indirect_limit";
const LIGHT_PATHS: &str = "renderflow/light_paths";
const DENOISER: &str = "renderflow/denoiser";
const CAMERA: &str = "renderflow/camera";
const SPP: &str = "spp";

/// Stores UTF-8 unchanged; the exr crate's own conversion stores Latin-1 and refuses other characters.
fn text(value: &str) -> Text {
    Text::from_slice_unchecked(value.as_bytes())
}

/// Fills the header from `info`.
pub(super) fn write(
    info: &FrameInfo,
    image: &mut ImageAttributes,
    layer: &mut LayerAttributes,
) -> std::result::Result<(), String> {
    info.check()?;
    image.chromaticities = Some(Chromaticities {
        red: (0.64, 0.33).into(),
        green: (0.30, 0.60).into(),
        blue: (0.15, 0.06).into(),
        white: (0.3127, 0.3290).into(),
    });
    layer.software_name = Some(text("RenderFlow"));
    let mut set = |name: &str, value: AttributeValue| layer.other.insert(text(name), value);
    let string = |value: &str| AttributeValue::Text(text(value));
    set("colorInteropID", string("lin_rec709_scene"));
    set(VERSION, string(env!("CARGO_PKG_VERSION")));
    set(CONVENTIONS, string(&channel::conventions()));
    set(SCENE_HASH, string(&info.scene_hash));
    if !info.scene_files.is_empty() {
        set(SCENE_FILES, string(&info.scene_files));
    }
    // A string, because OpenEXR has no 64-bit integer.
    set(SEED, string(&info.seed.to_string()));
    set(
        SPP,
        AttributeValue::I32(i32::try_from(info.spp).map_err(|_| format!("{} samples a pixel do not fit the header", info.spp))?),
    );
    set(EXPOSURE, AttributeValue::F32(info.exposure));
    if !info.bsdf.is_empty() {
        set(BSDF, string(&info.bsdf));
    }
    if !info.sampling.is_empty() {
        set(SAMPLING, string(&info.sampling));
    }
    if !info.lens.is_empty() {
        set(LENS, string(&info.lens));
    }
    if !info.shutter.is_empty() {
        set(SHUTTER, string(&info.shutter));
    }
    if let Some(bounces) = info.max_bounces {
        let value = i32::try_from(bounces).map_err(|_| format!("{bounces} bounces do not fit the header"))?;
        set(MAX_BOUNCES, AttributeValue::I32(value));
    }
    if let Some(branches) = info.branches {
        let value = i32::try_from(branches).map_err(|_| format!("{branches} samples a camera ray do not fit the header"))?;
        set(BRANCHES, AttributeValue::I32(value));
    }
    if let Some(limit) = info.indirect_limit {
        set(INDIRECT_LIMIT, AttributeValue::F32(limit));
    }
    if info.light_paths {
        set(LIGHT_PATHS, AttributeValue::I32(1));
    }
    if let Some(denoiser) = &info.denoiser {
        set(DENOISER, string(denoiser));
    }
    set(CAMERA, string(&serde_json::to_string(&info.camera).map_err(|e| e.to_string())?));
    layer.world_to_camera = Some(matrix(world_to_camera(&info.camera)));
    layer.world_to_normalized_device = Some(matrix(world_to_ndc(&info.camera)));
    Ok(())
}

/// Reads what [`write`] stored. Absent values, except the camera, take their defaults of [`FrameInfo::default`]; malformed values
/// are errors.
pub(super) fn read(header: &Header) -> std::result::Result<FrameInfo, String> {
    let other = &header.own_attributes.other;
    let string = |name: &str| match other.get(name.as_bytes()) {
        None => Ok(None),
        Some(AttributeValue::Text(value)) => match std::str::from_utf8(value.as_slice()) {
            Ok(value) => Ok(Some(value.to_owned())),
            Err(_) => Err(format!("header attribute {name} is not UTF-8")),
        },
        Some(_) => Err(format!("header attribute {name} is not a string")),
    };
    let conventions = string(CONVENTIONS)?.ok_or_else(|| format!("no frame file: header attribute {CONVENTIONS} is missing"))?;
    channel::check_conventions(&conventions).map_err(|reason| format!("header attribute {CONVENTIONS}: {reason}"))?;
    Ok(FrameInfo {
        camera: {
            let json = string(CAMERA)?.ok_or_else(|| format!("header attribute {CAMERA} is missing"))?;
            serde_json::from_str::<Camera>(&json).map_err(|e| format!("header attribute {CAMERA}: {e}"))?
        },
        spp: match other.get(SPP.as_bytes()) {
            None => 0,
            Some(AttributeValue::I32(spp)) if *spp >= 0 => *spp as u32,
            Some(_) => return Err(format!("header attribute {SPP} is not a count")),
        },
        seed: match string(SEED)? {
            None => 0,
            Some(seed) => seed.parse().map_err(|_| format!("header attribute {SEED} is not an unsigned integer"))?,
        },
        scene_hash: string(SCENE_HASH)?.unwrap_or_default(),
        scene_files: string(SCENE_FILES)?.unwrap_or_default(),
        exposure: match other.get(EXPOSURE.as_bytes()) {
            None => 0.0,
            Some(AttributeValue::F32(exposure)) if exposure.is_finite() => *exposure,
            Some(_) => return Err(format!("header attribute {EXPOSURE} is not a finite float")),
        },
        bsdf: string(BSDF)?.unwrap_or_default(),
        sampling: string(SAMPLING)?.unwrap_or_default(),
        lens: string(LENS)?.unwrap_or_default(),
        shutter: string(SHUTTER)?.unwrap_or_default(),
        max_bounces: match other.get(MAX_BOUNCES.as_bytes()) {
            None => None,
            Some(AttributeValue::I32(bounces)) if *bounces >= 0 => Some(*bounces as u32),
            Some(_) => return Err(format!("header attribute {MAX_BOUNCES} is not a count")),
        },
        branches: match other.get(BRANCHES.as_bytes()) {
            None => None,
            Some(AttributeValue::I32(branches)) if *branches > 0 => Some(*branches as u32),
            Some(_) => return Err(format!("header attribute {BRANCHES} is not a count")),
        },
        indirect_limit: match other.get(INDIRECT_LIMIT.as_bytes()) {
            None => None,
            Some(AttributeValue::F32(limit)) if *limit > 0.0 && limit.is_finite() => Some(*limit),
            Some(_) => return Err(format!("header attribute {INDIRECT_LIMIT} is not a finite positive float")),
        },
        light_paths: match other.get(LIGHT_PATHS.as_bytes()) {
            None => false,
            Some(AttributeValue::I32(flag @ 0..=1)) => *flag == 1,
            Some(_) => return Err(format!("header attribute {LIGHT_PATHS} is not 0 or 1")),
        },
        denoiser: string(DENOISER)?,
    })
}

/// World to OpenEXR's left-handed camera space: x right, y up, z along the view.
fn world_to_camera(camera: &Camera) -> Mat4 {
    let mut to_camera = Mat4::from(camera.world_to_camera());
    if camera.origin != DVec3::ZERO {
        // In double precision, because far from the world's origin the translation is the difference of large numbers.
        let turn = camera.camera_to_world.matrix3.transpose().as_dmat3();
        to_camera.w_axis = (-(turn * camera.position_in_world())).as_vec3().extend(1.0);
    }
    Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0)) * to_camera
}

/// World to OpenEXR's normalised device coordinates: after division by w, (0, 0) is the image's top left corner and (1, 1) its
/// bottom right; z, which readers are to discard, is 1 / depth.
fn world_to_ndc(camera: &Camera) -> Mat4 {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let projection = Mat4::from_cols(
        Vec4::new(camera.fl_x / width, 0.0, 0.0, 0.0),
        Vec4::new(0.0, -camera.fl_y / height, 0.0, 0.0),
        Vec4::new(camera.cx / width, camera.cy / height, 0.0, 1.0),
        Vec4::new(0.0, 0.0, 1.0, 0.0),
    );
    projection * world_to_camera(camera)
}

/// OpenEXR multiplies row vectors from the left and stores rows first: the same sixteen numbers as glam's columns.
fn matrix(m: Mat4) -> Matrix4x4 {
    m.to_cols_array()
}

/// Sorts the attributes of a single-part file by name, in place.
///
/// The exr crate keeps custom attributes in a hash map and writes them in random order, but the same frame must give the same
/// bytes. Offsets in the file stay correct because the header keeps its length.
pub(super) fn sort(bytes: &mut [u8]) -> Option<()> {
    // Magic number and version, then attributes (name, type, size, value) until an empty name.
    const START: usize = 8;
    let text_end = |from: usize| Some(from + bytes.get(from..)?.iter().position(|&b| b == 0)? + 1);
    let mut attributes = Vec::new();
    let mut at = START;
    while *bytes.get(at)? != 0 {
        let name_end = text_end(at)?;
        let type_end = text_end(name_end)?;
        let size = bytes.get(type_end..type_end + 4)?;
        let end = type_end + 4 + u32::from_le_bytes(size.try_into().ok()?) as usize;
        attributes.push(bytes.get(at..end)?.to_vec());
        at = end;
    }
    // Whole attributes compare by name first: a name ends with 0, which sorts before everything.
    attributes.sort_unstable();
    bytes[START..at].copy_from_slice(&attributes.concat());
    Some(())
}
