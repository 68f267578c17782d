//! Decodes and encodes Radiance RGBE in memory.
//!
//! The `image` crate is not used, because it reads only the `-Y +X` orientation and the `#?RADIANCE` signature, reads run lengths
//! in rows that are too narrow for them, names no row in its errors, and finds exponents with `log2`, whose last bit depends on
//! the platform. On ordinary files both decode to the same bits (`tests/hdr.rs`).

use crate::image::Rgb;

/// First bytes of every Radiance picture.
pub(crate) const SIGNATURE: &[u8] = b"#?";
/// Only rows of these widths can have run lengths (Radiance `color.c`).
const RUN_LENGTH_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32767;
/// Shorter repetitions cost as much as literals.
const MINIMUM_RUN: usize = 4;
/// Largest accepted number of pixels of a frame, 16384 x 16384.
pub(crate) const MAXIMUM_PIXELS: usize = 1 << 28;
/// Largest accepted number of texels of a map, 16384 x 8192: 1.6 GB of floats, and the same again for what a renderer derives
/// from them.
pub(crate) const MAXIMUM_TEXELS: usize = 1 << 27;
/// Largest accepted number of columns or rows.
pub(crate) const MAXIMUM_SIDE: usize = 1 << 16;

/// Largest number of texels per byte of run lengths: a run of 127 takes two bytes in each of four components.
const TEXELS_PER_BYTE: usize = 16;
/// Largest accepted number of texels, 0.8 GB of floats, of a file that is too small to hold them in run lengths: with the
/// repetitions of the format's first version 25 kilobytes can stand for 2^27 texels.
const MAXIMUM_REPEATED: usize = 1 << 26;

/// One texel as stored: three mantissas and the shared exponent.
type Texel = [u8; 4];

/// Radiance of a texel, `mantissa * 2^(exponent - 136)`; the factors are exact, so every machine gives the same bits.
fn to_radiance([r, g, b, exponent]: Texel) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    // 2^(e - 136) is subnormal in f32 for small exponents but always normal in f64.
    let scale = f64::from_bits((u64::from(exponent) + 1023 - 136) << 52);
    [r, g, b].map(|mantissa| (f64::from(mantissa) * scale) as f32)
}

/// The nearest texel; NaN and negative components count as 0, values beyond the format's range (about 1.7e38) as its largest.
fn from_radiance(rgb: [f32; 3]) -> Texel {
    let rgb = rgb.map(|v| if v > 0.0 { f64::from(v).min(LARGEST) } else { 0.0 });
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    if largest == 0.0 {
        return [0; 4];
    }
    // largest = f * 2^e with f in [0.5, 1): every f32 is a normal f64, so its exponent bits give e.
    let mut e = ((largest.to_bits() >> 52) & 0x7ff) as i32 - 1022;
    let quantise = |v: f64, e: i32| (v * f64::from_bits(((8 - e + 1023) as u64) << 52)).round();
    if quantise(largest, e) > 255.0 {
        e += 1;
    }
    let exponent = e + 128;
    if exponent < 1 {
        return [0; 4];
    }
    let [r, g, b] = rgb.map(|v| quantise(v, e) as u8);
    [r, g, b, exponent as u8]
}

/// 255 * 2^(255 - 136).
const LARGEST: f64 = 255.0 * (1u128 << 119) as f64;

/// The bytes that are not read yet.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.bytes.split_at_checked(count)?;
        self.bytes = tail;
        Some(head)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|b| b[0])
    }

    fn texel(&mut self) -> Option<Texel> {
        self.take(4).map(|b| [b[0], b[1], b[2], b[3]])
    }

    /// The text up to the next line feed, without it.
    fn line(&mut self) -> Option<String> {
        let end = self.bytes.iter().position(|&b| b == b'\n')?;
        let line = self.take(end + 1)?;
        Some(String::from_utf8_lossy(&line[..end]).trim_end_matches('\r').to_owned())
    }
}

/// How the rows of the file map to the picture.
struct Layout {
    /// Length of a stored row, and the number of stored rows.
    columns: usize,
    rows: usize,
    /// Whether a stored row is a column of the picture.
    transposed: bool,
    flip_x: bool,
    flip_y: bool,
}

fn header(reader: &mut Reader) -> Result<Layout, String> {
    loop {
        let line = reader.line().ok_or("the header has no end")?;
        if line.is_empty() {
            break;
        }
        if let Some(format) = line.strip_prefix("FORMAT=")
            && format.trim() != "32-bit_rle_rgbe"
        {
            return Err(format!("FORMAT is {:?}; only 32-bit_rle_rgbe is supported", shortened(format)));
        }
    }
    let line = reader.line().ok_or("the size line is missing")?;
    let bad_size = || format!("size line {:?} is not of the form \"-Y rows +X columns\"", shortened(&line));
    let [slow_axis, slow, fast_axis, fast] = line.split_whitespace().collect::<Vec<_>>()[..] else {
        return Err(bad_size());
    };
    let rows: usize = slow.parse().map_err(|_| bad_size())?;
    let columns: usize = fast.parse().map_err(|_| bad_size())?;
    let transposed = match (slow_axis, fast_axis) {
        ("-Y" | "+Y", "-X" | "+X") => false,
        ("-X" | "+X", "-Y" | "+Y") => true,
        _ => return Err(bad_size()),
    };
    if !(1..=MAXIMUM_SIDE).contains(&rows) || !(1..=MAXIMUM_SIDE).contains(&columns) || rows * columns > MAXIMUM_TEXELS {
        return Err(format!("{columns} x {rows} is outside 1..={MAXIMUM_SIDE} a side and {MAXIMUM_TEXELS} texels in all"));
    }
    let either = |axis| slow_axis == axis || fast_axis == axis;
    Ok(Layout { columns, rows, transposed, flip_x: either("-X"), flip_y: either("+Y") })
}

/// Header text for a message, shortened to a limit.
fn shortened(text: &str) -> String {
    text.chars().take(60).collect()
}

/// Columns and rows of the picture in a file; texels are not decoded.
pub(crate) fn size(bytes: &[u8]) -> Result<[usize; 2], String> {
    let Layout { columns, rows, transposed, .. } = header(&mut Reader { bytes })?;
    Ok(if transposed { [rows, columns] } else { [columns, rows] })
}

/// Decodes a whole file; an error tells what is wrong and where.
pub(crate) fn decode(bytes: &[u8]) -> Result<Rgb, String> {
    if !bytes.starts_with(SIGNATURE) {
        return Err("no Radiance signature".into());
    }
    let mut reader = Reader { bytes };
    let layout = header(&mut reader)?;
    let (pixels, justified) = (layout.columns * layout.rows, bytes.len().saturating_mul(TEXELS_PER_BYTE));
    if pixels > MAXIMUM_REPEATED.max(justified) {
        return Err(format!("{} x {} texels in a file of {} bytes", layout.columns, layout.rows, bytes.len()));
    }
    let mut row = vec![[0; 4]; layout.columns];
    // A header that promises more than the file holds costs nothing.
    let mut stored: Vec<[f32; 3]> = Vec::with_capacity(pixels.min(justified));
    for y in 0..layout.rows {
        decode_row(&mut reader, &mut row).map_err(|reason| format!("row {} of {}: {reason}", y + 1, layout.rows))?;
        stored.extend(row.iter().map(|&texel| to_radiance(texel)));
    }
    if !layout.transposed && !layout.flip_x && !layout.flip_y {
        return Ok(Rgb { width: layout.columns, height: layout.rows, pixels: stored });
    }
    let (width, height) = if layout.transposed { (layout.rows, layout.columns) } else { (layout.columns, layout.rows) };
    Ok(Rgb::from_fn(width, height, |x, y| {
        let x = if layout.flip_x { width - 1 - x } else { x };
        let y = if layout.flip_y { height - 1 - y } else { y };
        stored[if layout.transposed { x * layout.columns + y } else { y * layout.columns + x }]
    }))
}

const ENDS: &str = "the file ends here";

fn decode_row(reader: &mut Reader, row: &mut [Texel]) -> Result<(), String> {
    let first = reader.texel().ok_or(ENDS)?;
    let marked = first[0] == 2 && first[1] == 2 && first[2] < 128;
    if !marked || !RUN_LENGTH_WIDTHS.contains(&row.len()) {
        return decode_flat_row(reader, first, row);
    }
    let width = usize::from(first[2]) << 8 | usize::from(first[3]);
    if width != row.len() {
        return Err(format!("it says it is {width} texels long, the header says {}", row.len()));
    }
    for component in 0..4 {
        let mut x = 0;
        while x < row.len() {
            let count = usize::from(reader.byte().ok_or(ENDS)?);
            let length = if count > 128 { count - 128 } else { count };
            let target = row.get_mut(x..x + length).filter(|_| length > 0).ok_or("a run has no length or leaves the row")?;
            if count > 128 {
                let value = reader.byte().ok_or(ENDS)?;
                target.iter_mut().for_each(|texel| texel[component] = value);
            } else {
                let values = reader.take(length).ok_or(ENDS)?;
                target.iter_mut().zip(values).for_each(|(texel, &value)| texel[component] = value);
            }
            x += length;
        }
    }
    Ok(())
}

/// Plain texels, where (1, 1, 1, n) repeats the previous texel n times; consecutive markers are digits to base 256.
fn decode_flat_row(reader: &mut Reader, first: Texel, row: &mut [Texel]) -> Result<(), String> {
    let (mut x, mut shift, mut next) = (0, 0, Some(first));
    while x < row.len() {
        let texel = match next.take() {
            Some(texel) => texel,
            None => reader.texel().ok_or(ENDS)?,
        };
        if texel[..3] != [1, 1, 1] {
            row[x] = texel;
            x += 1;
            shift = 0;
            continue;
        }
        // Rows are at most 2^16 long: a third digit can only be zero or too much.
        let length = if shift <= 16 { usize::from(texel[3]) << shift } else { usize::MAX };
        let previous = x.checked_sub(1).map(|i| row[i]).ok_or("it begins with a repetition")?;
        let end = x.checked_add(length).ok_or("a repetition leaves the row")?;
        row.get_mut(x..end).ok_or("a repetition leaves the row")?.fill(previous);
        x = end;
        shift += 8;
    }
    Ok(())
}

/// Encodes with run lengths where the width allows them.
pub(crate) fn encode(map: &Rgb) -> Vec<u8> {
    let mut bytes =
        format!("#?RADIANCE\nSOFTWARE=renderflow\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n", map.height, map.width).into_bytes();
    for row in map.pixels.chunks_exact(map.width.max(1)) {
        let texels: Vec<Texel> = row.iter().map(|&rgb| from_radiance(rgb)).collect();
        if !RUN_LENGTH_WIDTHS.contains(&map.width) {
            // The largest mantissa of a texel is at least 128 here, so that no texel can be mistaken for a marker.
            bytes.extend(texels.as_flattened());
            continue;
        }
        bytes.extend([2, 2, (map.width >> 8) as u8, map.width as u8]);
        for component in 0..4 {
            let values: Vec<u8> = texels.iter().map(|texel| texel[component]).collect();
            encode_component(&values, &mut bytes);
        }
    }
    bytes
}

fn encode_component(values: &[u8], bytes: &mut Vec<u8>) {
    let run_at = |i: usize| values[i..].iter().take(127).take_while(|&&v| v == values[i]).count();
    let mut x = 0;
    while x < values.len() {
        let run = run_at(x);
        if run >= MINIMUM_RUN {
            bytes.extend([128 + run as u8, values[x]]);
            x += run;
            continue;
        }
        let mut end = x;
        while end < values.len() && end - x < 128 && run_at(end) < MINIMUM_RUN {
            end += 1;
        }
        bytes.push((end - x) as u8);
        bytes.extend(&values[x..end]);
        x = end;
    }
}
