//! Plots as inline SVG. Colours come from the page's style sheet (classes `c0` to `c9`), so that they suit light and dark.

use super::html::{STYLE, escape, scroll};
use super::place::{self, Patch};
use std::fmt::Write;

/// Number of colour classes in the style sheet.
pub const COLORS: usize = 10;
/// Mean width of a letter in labels, in pixels, for common sans-serif fonts at 12 pixels.
pub const LETTER: f64 = 7.0;
/// Size of plots in narrow windows, such as a phone held upright, in pixels.
const NARROW: (f64, f64) = (340.0, 380.0);
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [62.0, 14.0, 16.0, 48.0];

/// How an axis is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Linear.
    Linear,
    /// Linear, with ticks at whole numbers only.
    Count,
    /// Logarithmic; values that are not above 0 are left out.
    Log,
    /// Logarithmic, with ticks at powers of two.
    Doubling,
}

/// A point with its name.
#[derive(Clone, Debug, Default)]
pub struct Point {
    /// In units of the axes.
    pub at: (f64, f64),
    /// Ends of the interval in y.
    pub bar: Option<[f64; 2]>,
    /// Text beside it; empty for none.
    pub label: String,
    /// Text shown when a pointer is over it.
    pub title: String,
    /// Whether it is drawn faintly; then it does not count for the range of the axes.
    pub faint: bool,
}

/// Points of one colour.
#[derive(Clone, Debug, Default)]
pub struct Line {
    /// For scripts: the method; empty for none.
    pub id: String,
    /// Number of its colour; above [`COLORS`] they repeat, dashed.
    pub color: usize,
    /// Whether the points are joined.
    pub joined: bool,
    /// Name in a legend.
    pub legend: String,
    /// Whether the name is also written at the right end of the line.
    pub named: bool,
    /// Points that are joined come in the order of the line; loose points in any order.
    pub points: Vec<Point>,
}

/// A horizontal line to compare with.
#[derive(Clone, Debug)]
pub struct Level {
    /// Name in a legend.
    pub name: String,
    /// Whether the name is also written at its right end.
    pub named: bool,
    /// Number of its colour.
    pub color: usize,
    /// In units of the axis.
    pub y: f64,
}

/// A plot.
#[derive(Clone, Debug)]
pub struct Plot<'a> {
    /// Text for screen readers.
    pub title: &'a str,
    /// Name and scale of the x axis.
    pub x: (&'a str, Scale),
    /// Name and scale of the y axis.
    pub y: (&'a str, Scale),
    /// Points and lines.
    pub lines: Vec<Line>,
    /// Levels.
    pub levels: Vec<Level>,
    /// Values of x to mark at the bottom.
    pub marks: Vec<f64>,
    /// Width and height, pixels.
    pub size: (f64, f64),
}

/// Turns values into places.
pub struct Axis {
    scale: Scale,
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn is_log(scale: Scale) -> bool {
        matches!(scale, Scale::Log | Scale::Doubling)
    }

    /// An axis that covers the values, with a little room at both ends.
    pub fn new(values: impl Iterator<Item = f64>, scale: Scale, from: f64, to: f64) -> Self {
        // Ratios of numbers outside these would overflow.
        let usable = values.filter(|v| v.is_finite() && (!Self::is_log(scale) || (1e-30..=1e30).contains(v)));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = match scale {
            _ if low > high => (1.0, 10.0),
            Scale::Log | Scale::Doubling => {
                let room = (high / low).powf(0.05).max(1.1);
                (low / room, high * room)
            }
            Scale::Count if high - low < 4.0 => (low - 0.4, high + 0.4),
            Scale::Linear | Scale::Count => {
                let room = if high > low { 0.05 * (high - low) } else { 0.1 * high.abs().max(1.0) };
                (low - room, high + room)
            }
        };
        Self { scale, low, high, from, to }
    }

    /// The place of a value, if it has one.
    pub fn at(&self, value: f64) -> Option<f64> {
        let share = match self.scale {
            Scale::Linear | Scale::Count => (value - self.low) / (self.high - self.low),
            Scale::Log | Scale::Doubling => (value / self.low).ln() / (self.high / self.low).ln(),
        };
        share.is_finite().then_some(self.from + (self.to - self.from) * share)
    }

    /// As [`Axis::at`]; values beyond the ends are moved to the ends.
    fn within(&self, value: f64) -> Option<f64> {
        self.at(value.clamp(self.low, self.high))
    }

    /// Values to label.
    pub fn ticks(&self) -> Vec<f64> {
        let inside = |value: &f64| (self.low - 1e-9 * self.low.abs()..=self.high + 1e-9 * self.high.abs()).contains(value);
        let decades = (self.high / self.low).log10();
        // Within a third of a decade, 1, 2 and 5 may leave only one tick.
        if self.scale == Scale::Log && decades > 0.8 {
            let steps: &[f64] = if decades > 3.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
            return (first..=last).flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d))).filter(inside).collect();
        }
        if self.scale == Scale::Doubling {
            return (-20..40).map(|power| 2f64.powi(power)).filter(inside).collect();
        }
        let least = if self.scale == Scale::Count { 1.0 } else { 0.0 };
        let rough = ((self.high - self.low) / 6.0).max(least);
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|s| s * decade).into_iter().find(|s| *s >= rough).unwrap_or(rough);
        let first = (self.low / step).ceil() as i64;
        (0..20).map(|i| (first + i) as f64 * step).filter(inside).collect()
    }
}

/// The value of a tick, with all digits that it has: ticks may lie half a step of the last digit apart.
pub fn tick(value: f64) -> String {
    // Ten digits hide what rounding adds, as in 3 times 0.1.
    let value = format!("{value:.9e}").parse().unwrap_or(value);
    if value == 0.0 {
        "0".into()
    } else if (1e-4..1e5).contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// Width of a text in pixels.
pub fn text_width(text: &str) -> f64 {
    text.chars().count() as f64 * LETTER
}

/// The plot for wide and for narrow windows; the style sheet shows one of them. Names are at the lines, or in a legend below.
pub fn figure(plot: &Plot) -> String {
    let mut narrow = Plot { size: NARROW, ..plot.clone() };
    for line in &mut narrow.lines {
        line.named = false;
        line.points.iter_mut().filter(|point| text_width(&point.label) > NARROW.0 / 6.0).for_each(|point| point.label.clear());
    }
    narrow.levels.iter_mut().for_each(|level| level.named = false);
    let lines = plot.lines.iter().map(|line| (line.legend.as_str(), line.color, line.id.as_str()));
    let levels = plot.levels.iter().map(|level| (level.name.as_str(), level.color, ""));
    let mut legend = String::new();
    for (name, number, id) in lines.chain(levels).filter(|(name, ..)| !name.is_empty()) {
        let (dot, id) = (color(number), escape(id));
        // Writing to a string cannot fail.
        let _ = write!(legend, "<li class=\"end\" data-method=\"{id}\"><span class=\"dot {dot}\"></span>{}</li>", escape(name));
    }
    format!(
        "{}<div class=\"narrow\">\n{}<ul class=\"legend\">{legend}</ul></div>\n",
        scroll(plot.title, &svg(plot)).replacen("class=\"scroll\"", "class=\"scroll wide-plot\"", 1),
        svg(&narrow)
    )
}

/// The plot as an SVG file that stands alone, in the colours of the pages.
pub fn file(plot: &Plot) -> String {
    let (width, height) = plot.size;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"system-ui, sans-serif\">\n<title>{}</title>\n<style><![CDATA[\n{STYLE}]]></style>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"var(--back)\"/>\n{}</svg>\n",
        escape(plot.title),
        svg(plot)
    )
}

/// The plot as an `svg` element.
fn svg(plot: &Plot) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = draw(&mut out, plot);
    out
}

fn draw(out: &mut String, plot: &Plot) -> std::fmt::Result {
    let (width, height) = plot.size;
    let lines = plot.lines.iter().filter(|line| line.named).map(|line| line.legend.as_str());
    let names = lines.chain(plot.levels.iter().filter(|level| level.named).map(|level| level.name.as_str()));
    let room = names.map(text_width).fold(0.0, f64::max);
    let right = width - if room > 0.0 { room + 22.0 } else { MARGIN[2] };
    let [left, top, bottom] = [MARGIN[0], MARGIN[1], height - MARGIN[3]];
    let clear = || plot.lines.iter().flat_map(|line| &line.points).filter(|point| !point.faint);
    let x = Axis::new(clear().map(|p| p.at.0).chain(plot.marks.iter().copied()), plot.x.1, left, right);
    let ends = clear().flat_map(|p| p.bar.into_iter().flatten().chain([p.at.1]));
    let y = Axis::new(ends.chain(plot.levels.iter().map(|level| level.y)), plot.y.1, bottom, top);
    writeln!(
        out,
        "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" role=\"img\" aria-label=\"{}\" \
         data-x=\"{left} {right} {} {}\">",
        escape(plot.title),
        x.low,
        x.high
    )?;
    frame(out, plot, (&x, &y), [left, top, right, bottom])?;
    for level in &plot.levels {
        let Some(at) = y.at(level.y) else { continue };
        writeln!(
            out,
            "<g class=\"{}\"><line class=\"level\" x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/></g>",
            color(level.color)
        )?;
    }
    let mut taken = place::Taken::new([left, top, right, bottom]);
    for line in &plot.lines {
        marks(out, line, (&x, &y), &mut taken)?;
    }
    for line in &plot.lines {
        for point in line.points.iter().filter(|point| !point.label.is_empty()) {
            let (Some(px), Some(py)) = (x.at(point.at.0), y.at(point.at.1)) else { continue };
            label(out, &point.label, line.color, (px, py), &mut taken)?;
        }
    }
    end_names(out, plot, &y, [top, right, bottom])?;
    writeln!(out, "</svg>")
}

/// Grid, ticks and names of the axes.
fn frame(out: &mut String, plot: &Plot, (x, y): (&Axis, &Axis), [left, top, right, bottom]: [f64; 4]) -> std::fmt::Result {
    for value in x.ticks() {
        let Some(at) = x.at(value) else { continue };
        write!(out, "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\"/>")?;
        writeln!(out, "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", bottom + 17.0, tick(value))?;
    }
    for value in y.ticks() {
        let Some(at) = y.at(value) else { continue };
        write!(out, "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>")?;
        writeln!(out, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", left - 7.0, at + 4.0, tick(value))?;
    }
    for at in plot.marks.iter().filter_map(|mark| x.at(*mark)) {
        writeln!(out, "<path class=\"key\" d=\"M{at:.1} {:.1}l-4 -8h8z\"/>", bottom)?;
    }
    let (middle, foot) = (0.5 * (left + right), bottom + 38.0);
    writeln!(out, "<text class=\"axis\" x=\"{middle:.1}\" y=\"{foot:.1}\" text-anchor=\"middle\">{}</text>", escape(plot.x.0))?;
    let middle = 0.5 * (top + bottom);
    writeln!(
        out,
        "<text class=\"axis\" x=\"14\" y=\"{middle:.1}\" text-anchor=\"middle\" transform=\"rotate(-90 14 {middle:.1})\">{}</text>",
        escape(plot.y.0)
    )
}

/// The points of a line with their intervals.
fn marks(out: &mut String, line: &Line, (x, y): (&Axis, &Axis), taken: &mut place::Taken) -> std::fmt::Result {
    writeln!(out, "<g class=\"line {}\" data-method=\"{}\">", color(line.color), escape(&line.id))?;
    let place = |point: &Point| Some((x.within(point.at.0)?, y.within(point.at.1)?));
    let placed: Vec<(&Point, (f64, f64))> = line.points.iter().filter_map(|p| Some((p, place(p)?))).collect();
    if line.joined && placed.len() > 1 {
        let points: Vec<String> = placed.iter().map(|(_, (px, py))| format!("{px:.1},{py:.1}")).collect();
        writeln!(out, "<polyline points=\"{}\"/>", points.join(" "))?;
        for pair in placed.windows(2) {
            taken.segment(pair[0].1, pair[1].1);
        }
    }
    for (point, (px, py)) in placed {
        let class = if point.faint { " class=\"faint\"" } else { "" };
        write!(out, "<g{class}>")?;
        if let Some([a, b]) = point.bar.map(|bar| bar.map(|end| y.within(end))).and_then(|[a, b]| Some([a?, b?])) {
            write!(out, "<path d=\"M{px:.1} {a:.1}V{b:.1}M{:.1} {a:.1}h6M{:.1} {b:.1}h6\"/>", px - 3.0, px - 3.0)?;
            taken.segment((px, a), (px, b));
        }
        let radius = if point.faint { 2.5 } else { 4.0 };
        writeln!(
            out,
            "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"{radius}\"><title>{}</title></circle></g>",
            escape(&point.title)
        )?;
        taken.add(Patch::around((px, py), (5.0, 5.0)));
    }
    writeln!(out, "</g>")
}

fn label(out: &mut String, text: &str, number: usize, at: (f64, f64), taken: &mut place::Taken) -> std::fmt::Result {
    let spot = taken.place(at, (text_width(text), 12.0));
    let (cx, cy) = spot.center();
    if spot.distance(at) > 12.0 {
        let (nx, ny) = spot.nearest(at);
        write!(
            out,
            "<g class=\"{}\"><line class=\"lead\" x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{nx:.1}\" y2=\"{ny:.1}\"/></g>",
            color(number),
            at.0,
            at.1
        )?;
    }
    writeln!(
        out,
        "<text class=\"label {}\" x=\"{cx:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        color(number),
        cy + 4.0,
        escape(text)
    )
}

/// Names at the right ends of lines, moved apart where they would overlap.
fn end_names(out: &mut String, plot: &Plot, y: &Axis, [top, right, bottom]: [f64; 3]) -> std::fmt::Result {
    let lines = plot.lines.iter().filter(|line| line.named);
    let ends =
        lines.filter_map(|line| Some((y.within(line.points.last()?.at.1)?, line.legend.as_str(), line.color, line.id.as_str())));
    let levels = plot
        .levels
        .iter()
        .filter(|level| level.named)
        .filter_map(|level| Some((y.at(level.y)?, level.name.as_str(), level.color, "")));
    let mut names: Vec<(f64, &str, usize, &str)> = ends.chain(levels).collect();
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    let spots = place::spread(&names.iter().map(|name| name.0).collect::<Vec<_>>(), 14.0, top + 4.0, bottom);
    for ((end, name, number, id), spot) in names.into_iter().zip(spots) {
        writeln!(
            out,
            "<g class=\"end {0}\" data-method=\"{4}\"><path class=\"lead\" d=\"M{right} {end:.1}L{1:.1} {spot:.1}\"/>\
             <text class=\"label {0}\" x=\"{2:.1}\" y=\"{3:.1}\">{5}</text></g>",
            color(number),
            right + 12.0,
            right + 15.0,
            spot + 4.0,
            escape(id),
            escape(name)
        )?;
    }
    Ok(())
}

fn color(number: usize) -> String {
    let dashed = if number / COLORS % 2 == 1 { " dashed" } else { "" };
    format!("c{}{dashed}", number % COLORS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_where_the_values_say() {
        let axis = Axis { scale: Scale::Linear, low: 0.0, high: 10.0, from: 100.0, to: 0.0 };
        assert_eq!([axis.at(0.0), axis.at(2.5), axis.at(10.0), axis.at(f64::NAN)], [Some(100.0), Some(75.0), Some(0.0), None]);
        assert_eq!(axis.ticks(), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        let axis = Axis::new([0.1, 10.0].into_iter(), Scale::Log, 0.0, 100.0);
        assert!((axis.at(1.0).unwrap() - 50.0).abs() < 1e-9 && axis.at(0.0).is_none() && axis.at(-1.0).is_none());
        assert_eq!(axis.ticks().iter().map(|t| tick(*t)).collect::<Vec<_>>(), ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        for none in [vec![], vec![f64::NAN], vec![3.0]] {
            let axis = Axis::new(none.iter().copied(), Scale::Linear, 0.0, 1.0);
            assert!(axis.at(3.0).is_some() && !axis.ticks().is_empty() && axis.ticks().len() < 15, "{none:?}");
        }
        assert_eq!([tick(2e-7), tick(1e6), tick(0.05), tick(-0.0), tick(25.0)], ["2e-7", "1e6", "0.05", "0", "25"]);
        // Neighbours have labels of their own, which say where they are.
        for (low, high, expected) in [
            (0.0, 250_000.0, "0 50000 1e5 1.5e5 2e5 2.5e5"),
            (3e-4, 5e-4, "0.0003 0.00035 0.0004 0.00045 0.0005"),
            (2e-5, 4e-5, "2e-5 2.5e-5 3e-5 3.5e-5 4e-5"),
            (0.0, 0.6, "0 0.2 0.4 0.6"),
        ] {
            let axis = Axis::new([low, high].into_iter(), Scale::Linear, 0.0, 1.0);
            assert_eq!(axis.ticks().into_iter().map(tick).collect::<Vec<_>>().join(" "), expected);
        }
    }

    #[test]
    fn nothing_unusual_reaches_the_page() {
        let bad = |at| Point { at, label: "a<b & \"c\"".into(), bar: Some([f64::NAN, 2.0]), ..Point::default() };
        let points = vec![bad((1.0, -1.0)), bad((1.0, 2.0)), bad((f64::NAN, 1.0)), bad((2.0, f64::INFINITY)), bad((2.0, 1.0))];
        let lines = vec![Line { color: 23, joined: true, points, ..Line::default() }];
        let plot = Plot {
            title: "t",
            x: ("x", Scale::Log),
            y: ("y", Scale::Log),
            lines,
            levels: vec![],
            marks: vec![],
            size: (400.0, 300.0),
        };
        let text = svg(&plot);
        assert!(file(&plot).contains(&text));
        assert!(!text.contains("NaN") && !text.contains("inf") && text.contains("a&lt;b &amp; &quot;c&quot;"), "{text}");
    }
}
