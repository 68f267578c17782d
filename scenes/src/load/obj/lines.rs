//! Feeds tobj with lines it can take.
//!
//! tobj (4.0) fails on a whole file for one face out of range or vertex colours on some vertices only, and misaligns
//! coordinates when only some faces of a group have them. Here each line is checked first, so that such things cost a
//! face or an attribute, are counted, and errors know their line. It also looks up a material at the line that asks for it, so a
//! library that a later line names is handed out before that line.

use renderflow_frame::words::shortened;
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{BufRead, Read, Result, Write};

/// What was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LeftOut {
    /// Elements with fewer than three vertices.
    pub points_and_lines: usize,
    /// Faces with a vertex that does not exist, in triangles.
    pub triangles: usize,
    /// Faces whose texture coordinate or normal does not exist.
    pub attributes: usize,
    /// Colours of vertices, where the first vertex has none, and others than three numbers.
    pub colors: usize,
}

/// The lines of an OBJ file, cleaned one by one as they are read.
pub(super) struct Lines<'a> {
    rest: std::slice::Split<'a, u8, fn(&u8) -> bool>,
    cleaned: Vec<u8>,
    used: usize,
    /// Lines of the file read so far.
    pub(super) line: usize,
    /// Positions, texture coordinates, normals in the whole file, and up to this line.
    total: [usize; 3],
    so_far: [usize; 3],
    /// Name of the object, and which attributes its last face had.
    name: String,
    attributes: Option<[bool; 2]>,
    /// Whether the first vertex has a colour, and so all have.
    colored: Option<bool>,
    /// Names of materials asked for.
    pub(super) materials: Vec<String>,
    /// Whether each statement `mtllib` of the file was handed out, how many were read, and the first that defines a material.
    handed_out: Vec<bool>,
    libraries_so_far: usize,
    defined_in: HashMap<String, usize>,
    pub(super) left_out: LeftOut,
    /// The last line whose words are not what they should be, and why.
    pub(super) fault: Option<(usize, String)>,
    /// The first face with a vertex that does not exist.
    pub(super) missing_vertex: Option<String>,
    /// The first vertex with a coordinate that is not finite.
    pub(super) not_finite: Option<String>,
}

fn is_newline(byte: &u8) -> bool {
    *byte == b'\n'
}

fn is_attribute(line: &[u8]) -> Option<usize> {
    let line = line.trim_ascii_start();
    [&b"v"[..], b"vt", b"vn"]
        .iter()
        .position(|key| line.starts_with(key) && line.get(key.len()).is_some_and(u8::is_ascii_whitespace))
}

/// The ways in which C libraries print what is not a number (`-nan(ind)`, `1.#QNAN`, `-1.#IND`) become one that Rust reads.
fn number(word: &str) -> &str {
    let odd = || word.contains('#') || word.to_ascii_lowercase().trim_start_matches(['-', '+']).starts_with("nan");
    if word.parse::<f32>().is_err() && odd() { "nan" } else { word }
}

/// What follows the keyword of a line.
fn behind<'b>(text: &'b str, key: &str) -> &'b str {
    text.trim_start().get(key.len()..).unwrap_or_default().trim()
}

impl<'a> Lines<'a> {
    /// The lines of a text. `library` gets what each statement `mtllib` names, in their order, and returns the names of the
    /// materials defined there; tobj is handed the number of the statement.
    pub(super) fn new(text: &'a [u8], mut library: impl FnMut(&str) -> Vec<String>) -> Self {
        let mut total = [0; 3];
        text.split(|&b| b == b'\n').filter_map(is_attribute).for_each(|kind| total[kind] += 1);
        let rest = text.split(is_newline as fn(&u8) -> bool);
        let mut lines = Self {
            rest: rest.clone(),
            cleaned: vec![],
            used: 0,
            line: 0,
            total,
            so_far: [0; 3],
            name: "unnamed".into(),
            attributes: None,
            colored: None,
            materials: vec![],
            handed_out: vec![],
            libraries_so_far: 0,
            defined_in: HashMap::new(),
            left_out: LeftOut::default(),
            fault: None,
            missing_vertex: None,
            not_finite: None,
        };
        // Once through the text for the libraries, and back to its start.
        while let Some(line) = lines.next_line() {
            if !line.trim_ascii_start().starts_with(b"mtllib") {
                continue;
            }
            let text = String::from_utf8_lossy(&line);
            if text.split_whitespace().next() == Some("mtllib") {
                let number = lines.handed_out.len();
                lines.handed_out.push(false);
                for name in library(behind(&text, "mtllib")) {
                    lines.defined_in.entry(name).or_insert(number);
                }
            }
        }
        (lines.rest, lines.line) = (rest, 0);
        lines
    }

    /// The next line, with its continuations (a backslash at the end) joined.
    fn next_line(&mut self) -> Option<Cow<'a, [u8]>> {
        let mut line = Cow::Borrowed(self.rest.next()?);
        self.line += 1;
        while let Some(open) = line.trim_ascii_end().strip_suffix(b"\\").map(<[u8]>::len) {
            let Some(more) = self.rest.next() else { break };
            self.line += 1;
            let owned = line.to_mut();
            owned.truncate(open);
            owned.push(b' ');
            owned.extend_from_slice(more);
        }
        Some(line)
    }

    fn clean(&mut self, line: &[u8]) {
        let text = String::from_utf8_lossy(line);
        let mut words = text.split_whitespace();
        match words.next() {
            Some("v") => {
                self.so_far[0] += 1;
                let given = text.split_whitespace().count() - 1;
                // x y z, or x y z w, or x y z r g b. All vertices have colours or none has.
                let colored = *self.colored.get_or_insert(given == 6);
                match (given, colored) {
                    (6, true) => self.numbers("v", words.take(6)),
                    (_, true) => self.numbers("v", words.take(3).chain(["1"; 3])),
                    (4, false) => self.numbers("v", words.take(4)),
                    (_, false) => self.numbers("v", words.take(3)),
                }
                self.left_out.colors += usize::from(given > 4 && !(colored && given == 6));
                self.check_numbers(&text, 3);
            }
            Some("vt") => {
                self.so_far[1] += 1;
                // One-dimensional textures have u only.
                self.numbers("vt", words.chain(["0"]).take(2));
                self.check_numbers(&text, 1);
            }
            Some("vn") => {
                self.so_far[2] += 1;
                self.numbers("vn", words.take(3));
                self.check_numbers(&text, 3);
            }
            Some("f" | "fo") => self.face(words),
            Some("l" | "p") => self.left_out.points_and_lines += 1,
            Some("o" | "g") => {
                let rest = text.trim_start().get(1..).unwrap_or_default().trim();
                self.name = if rest.is_empty() { "unnamed".into() } else { rest.into() };
                self.attributes = None;
                self.cleaned.extend_from_slice(format!("o {}", self.name).as_bytes());
            }
            Some("mtllib") => {
                self.hand_out(self.libraries_so_far);
                self.libraries_so_far += 1;
            }
            Some("usemtl") => {
                let name = behind(&text, "usemtl");
                if let Some(&number) = self.defined_in.get(name) {
                    self.hand_out(number);
                }
                self.materials.push(name.into());
                self.cleaned.extend_from_slice(format!("usemtl {name}").as_bytes());
            }
            Some(_) => self.cleaned.extend_from_slice(text.trim().as_bytes()),
            None => {}
        }
        self.cleaned.push(b'\n');
    }

    /// Hands out a library unless it was before.
    fn hand_out(&mut self, number: usize) {
        if self.handed_out.get_mut(number).is_some_and(|done| !std::mem::replace(done, true)) {
            self.cleaned.extend_from_slice(format!("mtllib {number}\n").as_bytes());
        }
    }

    fn numbers<'b>(&mut self, key: &str, words: impl Iterator<Item = &'b str>) {
        self.cleaned.extend_from_slice(key.as_bytes());
        for word in words {
            self.cleaned.push(b' ');
            self.cleaned.extend_from_slice(number(word).as_bytes());
        }
    }

    /// Keeps what is wrong with the numbers of a line, of which `needed` at least have to be there.
    fn check_numbers(&mut self, text: &str, needed: usize) {
        let mut words = text.split_whitespace();
        let key = words.next().unwrap_or_default();
        let mut finite = true;
        for index in 0..needed {
            let fault = match words.next().map(|word| (word, number(word).parse::<f32>())) {
                Some((_, Ok(value))) => {
                    finite &= value.is_finite();
                    continue;
                }
                Some((word, Err(_))) => format!("{:?} is not a number", shortened(word)),
                None => format!("{key} has {index} numbers, {needed} are needed"),
            };
            self.fault = Some((self.line, fault));
            return;
        }
        if key == "v" && !finite && self.not_finite.is_none() {
            let values: Vec<String> = text.split_whitespace().skip(1).take(3).map(shortened).collect();
            self.not_finite = Some(format!("line {}: vertex {} is ({})", self.line, self.so_far[0], values.join(", ")));
        }
    }

    /// The first corner of a face whose vertex does not exist, as the file writes it.
    fn missing(&self, words: &[&str]) -> Option<String> {
        let word = words.iter().find(|word| self.corner(word).is_some_and(|corner| corner[0].is_none()))?;
        let index = word.split('/').next().unwrap_or_default();
        let there = if index.starts_with('-') {
            format!("there are {} before it", self.so_far[0])
        } else {
            format!("there are {}", self.total[0])
        };
        Some(format!("line {}: the face names vertex {:?}, {there}", self.line, shortened(index)))
    }

    /// Writes a face with positive indices that all exist, or one that tobj refuses where the words are no indices: its own check
    /// of indices overflows.
    fn face<'b>(&mut self, words: impl Iterator<Item = &'b str>) {
        let words: Vec<&str> = words.take_while(|w| !w.starts_with('#')).collect();
        let corners: Option<Vec<[Option<usize>; 3]>> = words.iter().map(|w| self.corner(w)).collect();
        let Some(corners) = corners else {
            let word = words.iter().find(|w| self.corner(w).is_none()).copied().unwrap_or_default();
            let fault = format!("{:?} is not a corner of a face: 1, 1/2, 1//3 and 1/2/3 are", shortened(word));
            self.fault = Some((self.line, fault));
            self.cleaned.extend_from_slice(b"f not an index");
            return;
        };
        if corners.len() < 3 {
            self.left_out.points_and_lines += 1;
            return;
        }
        if corners.iter().any(|c| c[0].is_none()) {
            self.left_out.triangles += corners.len() - 2;
            if self.missing_vertex.is_none() {
                self.missing_vertex = self.missing(&words);
            }
            return;
        }
        // An attribute that one corner lacks is of no use to the face.
        let has = [1, 2].map(|k| corners.iter().all(|c| c[k].is_some()));
        let asked = |k: usize| words.iter().any(|w| w.split('/').nth(k).is_some_and(|s| !s.is_empty()));
        self.left_out.attributes += usize::from((asked(1) && !has[0]) || (asked(2) && !has[1]));
        if self.attributes.replace(has).is_some_and(|before| before != has) {
            // A new object for tobj: its vertices have either all of an attribute or none.
            self.cleaned.extend_from_slice(format!("o {}\n", self.name).as_bytes());
        }
        self.cleaned.push(b'f');
        for corner in corners {
            // Writing to memory cannot fail.
            let [Some(v), vt, vn] = corner else { continue };
            let _ = write!(self.cleaned, " {v}");
            match (vt.filter(|_| has[0]), vn.filter(|_| has[1])) {
                (Some(vt), Some(vn)) => drop(write!(self.cleaned, "/{vt}/{vn}")),
                (Some(vt), None) => drop(write!(self.cleaned, "/{vt}")),
                (None, Some(vn)) => drop(write!(self.cleaned, "//{vn}")),
                (None, None) => {}
            }
        }
    }

    /// Indices (from 1) of position, texture coordinate and normal; `None` inside for absent or out of range, outside for no
    /// number.
    fn corner(&self, word: &str) -> Option<[Option<usize>; 3]> {
        let mut result = [None; 3];
        for (k, number) in word.split('/').enumerate() {
            if number.is_empty() {
                continue;
            }
            let slot = result.get_mut(k)?;
            let index: i64 = number.parse().ok()?;
            let absolute = if index < 0 { self.so_far[k] as i64 + 1 + index } else { index };
            *slot = usize::try_from(absolute).ok().filter(|i| (1..=self.total[k]).contains(i));
        }
        Some(result)
    }
}

impl Read for Lines<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let available = self.fill_buf()?;
        let count = available.len().min(buffer.len());
        buffer[..count].copy_from_slice(&available[..count]);
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Lines<'_> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        while self.used == self.cleaned.len() {
            self.cleaned.clear();
            self.used = 0;
            let Some(line) = self.next_line() else { break };
            self.clean(&line);
        }
        Ok(&self.cleaned[self.used..])
    }

    fn consume(&mut self, count: usize) {
        self.used = (self.used + count).min(self.cleaned.len());
    }
}
