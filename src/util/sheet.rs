//! Labelled sheets: pictures side by side, each with its name, and with a colour bar where its colours stand for numbers.

use super::picture::{self, ERROR_GAIN};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use renderflow_frame::image::{Image, Rgb};

/// Pixels between tiles and around them.
const GAP: usize = 8;
/// Height of a line of text, in pixels.
const LINE: usize = 20;
/// Height of a colour bar, in pixels.
const BAR: usize = 10;
/// Tiles have at least and at most this many columns: smaller pictures are repeated, larger ones averaged.
const WIDTHS: [usize; 2] = [224, 480];
const PAPER: [f32; 3] = [1.0; 3];
const INK: [f32; 3] = [0.1; 3];

/// The colours of numbers from 0 to 1.
pub type Scale = fn(f32) -> [f32; 3];

/// A colour bar: the colours of a scale, with what its ends stand for.
#[derive(Clone)]
pub struct Bar {
    /// The colours.
    pub scale: Scale,
    /// What the left end stands for.
    pub low: String,
    /// What the right end stands for.
    pub high: String,
}

/// A picture on a sheet.
#[derive(Clone)]
pub struct Tile {
    /// Stands above the picture.
    pub name: String,
    /// Display values, 0..=1.
    pub picture: Rgb,
    /// Stands below the picture, where there is one.
    pub bar: Option<Bar>,
}

impl Tile {
    /// A tile without a colour bar.
    pub fn new(name: impl Into<String>, picture: Rgb) -> Self {
        Self { name: name.into(), picture, bar: None }
    }
}

/// Dark blue over green to yellow, in steps that look equal: nine colours of matplotlib's "viridis" (CC0), and between them.
pub fn viridis(share: f32) -> [f32; 3] {
    const COLORS: [[u8; 3]; 9] = [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ];
    let place = share.clamp(0.0, 1.0) * (COLORS.len() - 1) as f32;
    let first = (place as usize).min(COLORS.len() - 2);
    let mix = place - first as f32;
    std::array::from_fn(|i| {
        let [a, b] = [COLORS[first][i], COLORS[first + 1][i]].map(|v| f32::from(v) / 255.0);
        a + mix * (b - a)
    })
}

/// The tiles in rows of `columns`, on white.
pub fn sheet(tiles: &[Tile], columns: usize) -> Rgb {
    let columns = columns.clamp(1, tiles.len().max(1));
    let pictures: Vec<Rgb> = tiles.iter().map(|tile| fitted(&tile.picture)).collect();
    let wide = pictures.iter().map(|picture| picture.width).max().unwrap_or(1);
    let rows: Vec<(&[Tile], &[Rgb])> = tiles.chunks(columns).zip(pictures.chunks(columns)).collect();
    let high = |(tiles, pictures): &(&[Tile], &[Rgb])| {
        let bar = if tiles.iter().any(|tile| tile.bar.is_some()) { 2 + BAR + LINE } else { 0 };
        LINE + pictures.iter().map(|picture| picture.height).max().unwrap_or(0) + bar
    };
    let height = GAP + rows.iter().map(|row| high(row) + GAP).sum::<usize>();
    let mut sheet = Image::filled(GAP + columns * (wide + GAP), height, PAPER);
    let mut top = GAP;
    for row in &rows {
        for (column, (tile, picture)) in row.0.iter().zip(row.1).enumerate() {
            let left = GAP + column * (wide + GAP);
            write(&mut sheet, left, top, wide, &tile.name);
            put(&mut sheet, left, top + LINE, picture);
            if let Some(bar) = &tile.bar {
                let below = top + LINE + picture.height + 2;
                let last = (picture.width - 1).max(1) as f32;
                put(&mut sheet, left, below, &Image::from_fn(picture.width, BAR, |x, _| (bar.scale)(x as f32 / last)));
                write(&mut sheet, left, below + BAR, picture.width, &bar.low);
                let end = left + picture.width.saturating_sub(text_width(&bar.high));
                write(&mut sheet, end, below + BAR, left + picture.width - end, &bar.high);
            }
        }
        top += high(row) + GAP;
    }
    sheet
}

/// The truth and other pictures of its size, each with its name; below them their errors, and the place where the errors are
/// largest.
pub fn comparison(truth: &Rgb, others: &[(String, Rgb)]) -> Rgb {
    let errors: Vec<Rgb> = others.iter().map(|(_, picture)| picture::error_map(picture, truth)).collect();
    let [x, y, side] = worst(truth, &errors);
    let crop = |picture: &Rgb| {
        let factor = (truth.width / side).max(1);
        repeated(&picture.crop(x, y, side, side), factor)
    };
    let bar = Bar { scale: picture::heat, low: "0".into(), high: format!("{} or more", 1.0 / ERROR_GAIN) };
    let mut tiles = vec![Tile::new("Truth", truth.clone())];
    tiles.extend(others.iter().map(|(name, picture)| Tile::new(name, picture.clone())));
    tiles.push(Tile::new("The place shown below", outlined(truth, x, y, side)));
    tiles.extend(others.iter().zip(errors).map(|((name, _), error)| Tile {
        name: format!("Error: {name}"),
        picture: error,
        bar: Some(bar.clone()),
    }));
    tiles.push(Tile::new("Truth", crop(truth)));
    tiles.extend(others.iter().map(|(name, picture)| Tile::new(name, crop(picture))));
    sheet(&tiles, others.len() + 1)
}

/// Left, top and side of the square in which the sum of all `errors` is largest.
fn worst(truth: &Rgb, errors: &[Rgb]) -> [usize; 3] {
    let (width, height) = (truth.width, truth.height);
    let side = (width.min(height) / 4).max(1);
    let step = (side / 4).max(1);
    let sum = |x: usize, y: usize| -> f64 {
        let square = (y..y + side).flat_map(|y| (x..x + side).map(move |x| y * width + x));
        square.flat_map(|i| errors.iter().map(move |error| error.pixels[i].iter().map(|v| f64::from(*v)).sum::<f64>())).sum()
    };
    let places = (0..=height - side).step_by(step).flat_map(|y| (0..=width - side).step_by(step).map(move |x| [x, y]));
    let best = places.map(|[x, y]| (sum(x, y), [x, y])).reduce(|a, b| if b.0 > a.0 { b } else { a });
    best.map_or([0, 0, side], |(_, [x, y])| [x, y, side])
}

/// The picture with a frame around a square of it.
fn outlined(picture: &Rgb, left: usize, top: usize, side: usize) -> Rgb {
    let thick = (picture.width / 128).max(1);
    Image::from_fn(picture.width, picture.height, |x, y| {
        let inside = |margin: usize| {
            let within = |v: usize, from: usize| v + margin >= from && v < from + side + margin;
            within(x, left) && within(y, top)
        };
        if inside(thick) && !inside(0) { [1.0, 0.2, 0.1] } else { *picture.at(x, y) }
    })
}

/// Each pixel `factor` by `factor` times.
fn repeated(picture: &Rgb, factor: usize) -> Rgb {
    Image::from_fn(picture.width * factor, picture.height * factor, |x, y| *picture.at(x / factor, y / factor))
}

/// The picture in a width that suits a tile.
fn fitted(picture: &Rgb) -> Rgb {
    let [least, most] = WIDTHS;
    if picture.width < least {
        // A narrow picture may be very high.
        let room = (most / picture.width.max(1)).min(4 * most / picture.height.max(1));
        return repeated(picture, least.div_ceil(picture.width.max(1)).min(room).max(1));
    }
    picture::reduced(picture, most)
}

/// Copies `picture` to a place of the sheet.
fn put(sheet: &mut Rgb, left: usize, top: usize, picture: &Rgb) {
    for (y, row) in picture.pixels.chunks(picture.width.max(1)).enumerate() {
        let start = (top + y) * sheet.width + left;
        sheet.pixels[start..start + picture.width].copy_from_slice(row);
    }
}

/// Columns that `text` takes.
fn text_width(text: &str) -> usize {
    text.chars().count() * get_raster_width(FontWeight::Regular, RasterHeight::Size16)
}

/// The beginning of `text` that fits into `letters`. Dots say that something is left out, since half a number is another number.
fn fitting(text: &str, letters: usize) -> String {
    if text.chars().count() <= letters {
        return text.to_owned();
    }
    text.chars().take(letters.saturating_sub(2)).chain("..".chars()).take(letters).collect()
}

/// Writes as much of `text` as fits into `wide` columns; letters beyond ASCII become question marks.
fn write(sheet: &mut Rgb, left: usize, top: usize, wide: usize, text: &str) {
    let letter = get_raster_width(FontWeight::Regular, RasterHeight::Size16);
    for (number, character) in fitting(text, wide / letter).chars().enumerate() {
        let glyph = |c| get_raster(c, FontWeight::Regular, RasterHeight::Size16);
        let Some(glyph) = glyph(character).or_else(|| glyph('?')) else { continue };
        for (y, row) in glyph.rows().enumerate() {
            for (x, &cover) in row.iter().enumerate() {
                let at = (top + y) * sheet.width + left + number * letter + x;
                let share = f32::from(cover) / 255.0;
                if let Some(pixel) = sheet.pixels.get_mut(at) {
                    *pixel = std::array::from_fn(|i| pixel[i] + share * (INK[i] - pixel[i]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_carry_their_names_and_bars() {
        let grey = Image::filled(256, 100, [0.5; 3]);
        let bar = Bar { scale: viridis, low: "1 m".into(), high: "9 m".into() };
        let named = [Tile::new("beauty", grey.clone()), Tile { name: "depth".into(), picture: grey.clone(), bar: Some(bar) }];
        let made = sheet(&named, 4);
        assert_eq!([made.width, made.height], [GAP + 2 * (256 + GAP), GAP + LINE + 100 + 2 + BAR + LINE + GAP]);
        // The picture is there, and so are the ends of the scale below the second one.
        assert_eq!(*made.at(GAP, GAP + LINE), [0.5; 3]);
        assert_eq!(*made.at(GAP + 256 + GAP, GAP + LINE + 100 + 2), viridis(0.0));
        assert_eq!(*made.at(GAP + 256 + GAP + 255, GAP + LINE + 100 + 2), viridis(1.0));
        // Another name makes another sheet: names are drawn.
        let dark = |sheet: &Rgb| sheet.pixels.iter().filter(|p| p[0] < 0.4 && p[0] == p[1]).count();
        let unnamed = [Tile::new("", grey.clone()), Tile::new("", grey)];
        assert!(dark(&made) > 50 && dark(&sheet(&unnamed, 4)) == 0);
    }

    #[test]
    fn what_is_left_out_of_a_name_is_marked() {
        let names = ["neural, 23.45 dB", "neural, 123.4 dB, 5"].map(|name| fitting(name, 16));
        assert_eq!(names, ["neural, 23.45 dB", "neural, 123.4 .."]);
        assert_eq!([0, 1, 2, 3].map(|letters| fitting("path", letters)), ["", ".", "..", "p.."]);
    }

    #[test]
    fn sizes_suit_tiles() {
        let width = |width: usize| fitted(&Image::filled(width, 3, [0.0; 3])).width;
        assert_eq!([1, 16, 200, 256, 480, 4096].map(width), [224, 224, 400, 256, 480, 480]);
        // A narrow picture that is very high is not made higher.
        assert_eq!(fitted(&Image::filled(1, 16384, [0.0; 3])).width, 1);
    }

    #[test]
    fn the_place_of_the_largest_error_is_found() {
        let truth = Image::filled(64, 48, [0.5; 3]);
        let other =
            Image::from_fn(64, 48, |x, y| if (40..44).contains(&x) && (30..34).contains(&y) { [1.0; 3] } else { [0.5; 3] });
        let [x, y, side] = worst(&truth, &[picture::error_map(&other, &truth)]);
        assert!(x <= 40 && x + side >= 44 && y <= 30 && y + side >= 34, "{x} {y} {side}");
        let made = comparison(&truth, &[("other".into(), other)]);
        // Both columns have three rows: pictures, errors with a bar, enlarged places.
        assert!(made.width >= 2 * WIDTHS[0] && made.height > 3 * 48);
    }
}
