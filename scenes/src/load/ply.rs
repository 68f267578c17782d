//! Stanford PLY: ASCII and binary of either byte order; vertices with normals, texture coordinates, colours and opacities;
//! polygons and strips.
//!
//! The parser is here because a header may claim any number of elements: memory is taken only for what the file has bytes for.

use super::model::{Model, Part};
use super::polygon;
use crate::error::{Error, Result};
use crate::{Material, Mesh};
use glam::{DAffine3, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::color::srgb_to_linear;
use renderflow_frame::file;
use renderflow_frame::words::shortened;
use std::path::Path;

/// Most lines of a header.
const MOST_LINES: usize = 1 << 16;

/// Types of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn whole(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// What stands for one in a colour, where it is a whole number: 255, unless the type says that there are 16 bits.
    fn full(self) -> Option<f32> {
        self.whole().then_some(if self == Self::U16 { 65535.0 } else { 255.0 })
    }

    /// The number in the first bytes of `bytes`, lowest byte first.
    fn read(self, bytes: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

/// A property of an element.
struct Property {
    name: String,
    kind: Kind,
    /// Type of the length, where it is a list.
    list: Option<Kind>,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

/// How the numbers behind the header are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Ascii,
    Little,
    Big,
}

/// The bytes behind the header.
struct Body<'a> {
    rest: &'a [u8],
    form: Form,
}

impl Body<'_> {
    /// The next number; an error says what is there in its place.
    fn number(&mut self, kind: Kind) -> std::result::Result<f64, String> {
        if self.form == Form::Ascii {
            self.rest = self.rest.trim_ascii_start();
            let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
            let (word, rest) = self.rest.split_at(end);
            self.rest = rest;
            let word = str::from_utf8(word).unwrap_or("?");
            if word.is_empty() {
                return Err("the file ends".into());
            }
            return word.parse().map_err(|_| format!("{:?} is not a number", shortened(word)));
        }
        let Some((own, rest)) = self.rest.split_at_checked(kind.size()) else { return Err("the file ends".into()) };
        self.rest = rest;
        let mut bytes = [0; 8];
        bytes[..own.len()].copy_from_slice(own);
        if self.form == Form::Big {
            bytes[..own.len()].reverse();
        }
        Ok(kind.read(bytes))
    }

    /// The next list.
    fn list(&mut self, length: Kind, kind: Kind, items: &mut Vec<f64>) -> std::result::Result<(), String> {
        let count = self.number(length)?;
        if !(0.0..=f64::from(u32::MAX)).contains(&count) || count.fract() != 0.0 {
            return Err(format!("{count} is no length of a list"));
        }
        items.clear();
        for _ in 0..count as u64 {
            items.push(self.number(kind)?);
        }
        Ok(())
    }

    /// Elements that the rest can hold at most, if each has so many numbers and lists.
    fn room(&self, element: &Element) -> usize {
        let least = |p: &Property| if self.form == Form::Ascii { 1 } else { p.list.unwrap_or(p.kind).size() };
        self.rest.len() / element.properties.iter().map(least).sum::<usize>().max(1)
    }
}

/// Reads a `.ply` file; if materials are asked for, the colours of its vertices with a material.
pub(super) fn read(path: &Path, materials: bool) -> Result<Model> {
    let bytes = file::read(path)?;
    let (form, elements, body) = header(&bytes).map_err(|(line, reason)| Error::model(path, format!("line {line}"), reason))?;
    let mut body = Body { rest: body, form };
    let name = path.file_stem().map_or_else(|| "mesh".into(), |stem| stem.to_string_lossy().into_owned());
    let mut read = Read { mesh: Mesh { name: name.clone(), ..Mesh::default() }, ..Read::default() };
    for element in &elements {
        if element.properties.is_empty() {
            continue;
        }
        let fail = |at: u64, reason: String| Error::model(path, format!("{} {at}", shortened(&element.name)), reason);
        match element.name.as_str() {
            "vertex" => read.vertices(element, &mut body).map_err(|(at, reason)| fail(at, reason))?,
            "face" | "tristrips" => read.faces(element, &mut body).map_err(|(at, reason)| fail(at, reason))?,
            _ => {
                let mut list = vec![];
                for at in 0..element.count {
                    for property in &element.properties {
                        body.property(property, &mut list).map_err(|reason| fail(at, reason))?;
                    }
                }
                read.notes.push(format!("{} elements {:?} are not read", element.count, shortened(&element.name)));
            }
        }
    }
    let mut model = Model::default();
    if !elements.iter().any(|element| element.name == "vertex") {
        return Err(Error::model(path, "", "the file has no vertices"));
    }
    if read.mesh.triangles.is_empty() {
        read.notes.push("the file has no faces: points are not rendered".into());
    }
    let color = read.color(materials);
    model.report.notes = read.notes;
    if !read.mesh.triangles.is_empty() {
        let material = color.map(|color| {
            // What covers everything is made opaque where the scene is built.
            let mut material = Material { name: name.clone(), opacity: Some(color.w), ..Material::default() };
            material.surface.base_color = Vec3A::from_vec4(color);
            model.materials.push(material);
            0
        });
        model.parts.push(Part { name, mesh: 0, material, transform: DAffine3::IDENTITY, node: 0, deformer: None });
        model.meshes.push(read.mesh);
    }
    Ok(model)
}

/// The form, the elements, and what follows the header.
type Header<'a> = (Form, Vec<Element>, &'a [u8]);

/// Reads the header. An error comes with its line.
fn header(bytes: &[u8]) -> std::result::Result<Header<'_>, (usize, String)> {
    let (mut form, mut elements): (Option<Form>, Vec<Element>) = (None, vec![]);
    let mut rest = bytes;
    for number in 1..=MOST_LINES {
        let fail = |reason: String| Err((number, reason));
        let Some(end) = rest.iter().position(|&b| b == b'\n' || b == b'\r') else {
            return fail("the header does not end".into());
        };
        let line = &rest[..end];
        let both = rest[end..].starts_with(b"\r\n");
        rest = &rest[end + 1 + usize::from(both)..];
        let line = String::from_utf8_lossy(line);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            _ if number == 1 => return fail("not a PLY file".into()),
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, "1.0"] => {
                form = match *name {
                    "ascii" => Some(Form::Ascii),
                    "binary_little_endian" => Some(Form::Little),
                    "binary_big_endian" => Some(Form::Big),
                    other => return fail(format!("{:?} is no format of PLY", shortened(other))),
                }
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else { return fail(format!("{:?} is no number of elements", shortened(count))) };
                elements.push(Element { name: (*name).into(), count, properties: vec![] });
            }
            ["property", kinds @ .., name] if matches!(kinds, [_] | ["list", _, _]) => {
                let Some(element) = elements.last_mut() else { return fail("the property belongs to no element".into()) };
                let list = if let ["list", length, _] = kinds { Some(*length) } else { None };
                let kind = kinds[kinds.len() - 1];
                let unknown = |word: &str| format!("{:?} is no type of a number", shortened(word));
                let Some(kind) = Kind::of(kind) else { return fail(unknown(kind)) };
                let list = match list {
                    None => None,
                    Some(word) => match Kind::of(word) {
                        Some(length) if length.whole() => Some(length),
                        _ => return fail(unknown(word)),
                    },
                };
                element.properties.push(Property { name: (*name).into(), kind, list });
            }
            ["end_header"] => {
                let Some(form) = form else { return fail("the header has no format".into()) };
                return Ok((form, elements, rest));
            }
            _ => return fail(format!("{:?} is not known", shortened(line.trim()))),
        }
    }
    Err((MOST_LINES, "the header does not end".into()))
}

impl Body<'_> {
    /// Reads a property, a list into `list`; a single number is the result, or else the length.
    fn property(&mut self, property: &Property, list: &mut Vec<f64>) -> std::result::Result<f64, String> {
        match property.list {
            None => self.number(property.kind),
            Some(length) => self.list(length, property.kind, list).map(|()| list.len() as f64),
        }
    }
}

/// What a vertex may have, in the order of [`Read::vertices`].
const NAMES: [&[&str]; 12] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["s", "u", "texture_u", "texture_s"],
    &["t", "v", "texture_v", "texture_t"],
    &["red", "r", "diffuse_red"],
    &["green", "g", "diffuse_green"],
    &["blue", "b", "diffuse_blue"],
    &["alpha", "a", "diffuse_alpha"],
];

/// What was read so far.
#[derive(Default)]
struct Read {
    mesh: Mesh,
    notes: Vec<String>,
}

impl Read {
    /// An error comes with the number of the vertex.
    fn vertices(&mut self, element: &Element, body: &mut Body) -> std::result::Result<(), (u64, String)> {
        if element.count > u64::from(u32::MAX) {
            return Err((0, format!("{} vertices are too many", element.count)));
        }
        let single =
            |names: &[&str]| element.properties.iter().position(|p| p.list.is_none() && names.contains(&p.name.as_str()));
        let columns = NAMES.map(single);
        if let Some(missing) = columns[..3].iter().position(Option::is_none) {
            return Err((0, format!("the vertices have no {}", NAMES[missing][0])));
        }
        let has = |range: std::ops::Range<usize>| columns[range].iter().all(Option::is_some);
        let [normals, uvs, colors] = [has(3..6), has(6..8), has(8..11)];
        let room = body.room(element).min(element.count as usize);
        let mesh = &mut self.mesh;
        mesh.positions.reserve(room);
        mesh.normals.reserve(if normals { room } else { 0 });
        mesh.uvs.reserve(if uvs { room } else { 0 });
        mesh.colors.reserve(if colors { room } else { 0 });
        let (mut values, mut list) = (vec![0.0; element.properties.len()], vec![]);
        for at in 0..element.count {
            for (property, value) in element.properties.iter().zip(&mut values) {
                *value = body.property(property, &mut list).map_err(|reason| (at, reason))?;
            }
            let value = |column: usize| columns[column].map_or(0.0, |place| values[place]) as f32;
            mesh.positions.push(Vec3::new(value(0), value(1), value(2)));
            if normals {
                mesh.normals.push(Vec3::new(value(3), value(4), value(5)));
            }
            if uvs {
                // v runs up in these files and down here.
                mesh.uvs.push(Vec2::new(value(6), 1.0 - value(7)));
            }
            if colors {
                let full = |column: usize| columns[column].and_then(|place| element.properties[place].kind.full());
                let share = |column: usize| (value(column) / full(column).unwrap_or(1.0)).clamp(0.0, 1.0);
                // Whole numbers are encoded as sRGB; floats, and the opacity of any type, are linear.
                let channel = |column| if full(column).is_some() { srgb_to_linear(share(column)) } else { share(column) };
                let opacity = if columns[11].is_some() { share(11) } else { 1.0 };
                mesh.colors.push(Vec4::new(channel(8), channel(9), channel(10), opacity));
            }
        }
        // A part of a colour, such as an opacity alone, is not read.
        let read = if colors { &columns[..] } else { &columns[..8] };
        let known = read.iter().flatten().copied().collect::<Vec<usize>>();
        let unread = element.properties.iter().enumerate().filter(|(place, _)| !known.contains(place));
        let names: Vec<String> = unread.map(|(_, property)| shortened(&property.name)).take(12).collect();
        if !names.is_empty() {
            self.notes.push(format!("properties of vertices that are not read: {}", names.join(", ")));
        }
        Ok(())
    }

    /// Polygons as triangles, and strips; -1 ends a strip. An error comes with the number of the face.
    fn faces(&mut self, element: &Element, body: &mut Body) -> std::result::Result<(), (u64, String)> {
        let strips = element.name == "tristrips";
        let indices = |p: &Property| p.list.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
        let Some(place) = element.properties.iter().position(indices) else {
            return Err((0, "the faces have no vertex_indices".into()));
        };
        let (mut list, mut other, mut face, mut small) = (vec![], vec![], vec![], 0);
        self.mesh.triangles.reserve(body.room(element).min(element.count as usize));
        let vertex = |index: f64| if (0.0..f64::from(u32::MAX)).contains(&index) { index as u32 } else { u32::MAX };
        for at in 0..element.count {
            for (number, property) in element.properties.iter().enumerate() {
                let into = if number == place { &mut list } else { &mut other };
                body.property(property, into).map_err(|reason| (at, reason))?;
            }
            let triangles = &mut self.mesh.triangles;
            if strips {
                for strip in list.split(|&index| index == -1.0) {
                    let at = |i: usize| vertex(strip[i]);
                    let windows = 0..strip.len().saturating_sub(2);
                    triangles.extend(windows.map(|i| [at(i), at(i + 1 + i % 2), at(i + 2 - i % 2)]));
                }
            } else {
                small += usize::from(list.len() < 3);
                face.clear();
                face.extend(list.iter().map(|&index| vertex(index)));
                polygon::cut(&face, &self.mesh.positions, triangles);
            }
        }
        if small > 0 {
            self.notes.push(format!("{small} faces of fewer than three vertices skipped"));
        }
        let names = element.properties.iter().enumerate().filter(|(number, _)| *number != place);
        let names: Vec<String> = names.map(|(_, property)| shortened(&property.name)).take(12).collect();
        if !names.is_empty() {
            self.notes.push(format!("properties of faces that are not read: {}", names.join(", ")));
        }
        Ok(())
    }

    /// The base colour and opacity of a material for the mesh, if its vertices have colours: theirs where all have the same, else
    /// white and 1. Where no material is wanted, the colours are dropped.
    fn color(&mut self, wanted: bool) -> Option<Vec4> {
        let colors = &mut self.mesh.colors;
        // Some programs leave the opacity at 0 where they do not use it.
        if wanted && !colors.is_empty() && colors.iter().all(|color| color.w == 0.0) {
            colors.iter_mut().for_each(|color| color.w = 1.0);
            self.notes.push("the opacity of all vertices is 0; it is not used".into());
        }
        let first = *colors.first()?;
        let same = colors.iter().all(|color| *color == first);
        if same || !wanted {
            colors.clear();
        }
        wanted.then_some(if same { first } else { Vec4::ONE })
    }
}
