//! Curves on logarithmic axes, as SVG.

use std::fmt::Write;

/// Colours that stay apart for most kinds of colour blindness (Okabe and Ito 2008), and three more.
const COLORS: [&str; 10] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#8c6d31", "#7b4fb5", "#888888"];
const DASHES: [&str; 4] = ["", "7 4", "2 3", "10 3 2 3"];
const SIZE: [f64; 2] = [980.0, 560.0];
/// Left, top, right (the legend's place), bottom.
const MARGIN: [f64; 4] = [78.0, 44.0, 220.0, 58.0];

/// One line of a plot.
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Number of its colour.
    pub color: usize,
    /// Number of its dash pattern, 0 = drawn through.
    pub dash: usize,
    /// (x, y); what is not above 0 and finite is left out.
    pub points: Vec<(f64, f64)>,
}

/// A plot with logarithmic axes.
pub struct Plot<'a> {
    /// Heading.
    pub title: &'a str,
    /// What x counts.
    pub x: &'a str,
    /// What y counts.
    pub y: &'a str,
    /// A level to mark, in y.
    pub goal: Option<f64>,
    /// The lines.
    pub curves: &'a [Curve],
}

/// A logarithmic axis from a value to a place.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    /// Covers `values` rounded outwards to 1, 2 or 5 times a power of ten.
    fn new(values: impl Iterator<Item = f64>, from: f64, to: f64) -> Self {
        let (low, high) = values.fold((f64::INFINITY, 0.0), |(l, h): (f64, f64), v| (l.min(v), h.max(v)));
        if low > high {
            return Self { low: 0.1, high: 10.0, from, to };
        }
        let steps = |v: f64| {
            let decade = 10f64.powf(v.log10().floor());
            [1.0, 2.0, 5.0, 10.0].map(|m| m * decade)
        };
        let below = steps(low).into_iter().rfind(|&s| s <= low * (1.0 + 1e-9)).unwrap_or(low);
        let above = steps(high).into_iter().find(|&s| s >= high * (1.0 - 1e-9)).unwrap_or(high);
        let (low, high) = if below < above { (below, above) } else { (below / 2.0, above * 2.0) };
        Self { low, high, from, to }
    }

    fn at(&self, value: f64) -> f64 {
        self.from + (self.to - self.from) * (value / self.low).ln() / (self.high / self.low).ln()
    }

    /// Lines of the grid, each with whether it has a label.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let decades = (self.high / self.low).log10();
        let labelled: &[u32] = if decades > 3.5 { &[1] } else { &[1, 2, 5] };
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        (first..=last)
            .flat_map(|decade| (1..10u32).map(move |m| (m, f64::from(m) * 10f64.powi(decade))))
            .filter(|(_, value)| (self.low * 0.999..=self.high * 1.001).contains(value))
            .map(|(m, value)| (value, labelled.contains(&m)))
            .collect()
    }
}

/// The plot as a whole SVG file.
pub fn svg(plot: &Plot) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = draw(&mut out, plot);
    out
}

fn draw(out: &mut String, plot: &Plot) -> std::fmt::Result {
    let [width, height] = SIZE;
    let [left, top, right, bottom] = [MARGIN[0], MARGIN[1], width - MARGIN[2], height - MARGIN[3]];
    let good = |p: &&(f64, f64)| [p.0, p.1].iter().all(|v| v.is_finite() && *v > 0.0);
    let points = || plot.curves.iter().flat_map(|c| c.points.iter().filter(good));
    let x = Axis::new(points().map(|p| p.0), left, right);
    let y = Axis::new(points().map(|p| p.1).chain(plot.goal), bottom, top);
    writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"13\" fill=\"#222\">"
    )?;
    writeln!(out, "<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>")?;
    writeln!(out, "<text x=\"{left}\" y=\"26\" font-size=\"17\" font-weight=\"bold\">{}</text>", escape(plot.title))?;
    for (value, labelled) in x.ticks() {
        let at = x.at(value);
        let shade = if labelled { "#c4c4c4" } else { "#ececec" };
        writeln!(out, "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\" stroke=\"{shade}\"/>")?;
        if labelled {
            writeln!(out, "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", bottom + 18.0, number(value))?;
        }
    }
    for (value, labelled) in y.ticks() {
        let at = y.at(value);
        let shade = if labelled { "#c4c4c4" } else { "#ececec" };
        writeln!(out, "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"{shade}\"/>")?;
        if labelled {
            let (tx, ty) = (left - 8.0, at + 4.5);
            writeln!(out, "<text x=\"{tx}\" y=\"{ty:.1}\" text-anchor=\"end\">{}</text>", number(value))?;
        }
    }
    if let Some(goal) = plot.goal {
        let at = y.at(goal);
        writeln!(
            out,
            "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#b00\" stroke-width=\"1.5\" stroke-dasharray=\"4 3\"/>"
        )?;
    }
    writeln!(
        out,
        "<rect x=\"{left}\" y=\"{top}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#444\"/>",
        right - left,
        bottom - top
    )?;
    let middle = 0.5 * (left + right);
    writeln!(out, "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>", bottom + 42.0, escape(plot.x))?;
    let middle = 0.5 * (top + bottom);
    writeln!(
        out,
        "<text x=\"20\" y=\"{middle}\" text-anchor=\"middle\" transform=\"rotate(-90 20 {middle})\">{}</text>",
        escape(plot.y)
    )?;
    for (row, curve) in plot.curves.iter().enumerate() {
        let color = COLORS[curve.color % COLORS.len()];
        let dash = DASHES[curve.dash % DASHES.len()];
        let style =
            format!("stroke=\"{color}\" stroke-width=\"2\" stroke-dasharray=\"{}\"", if dash.is_empty() { "none" } else { dash });
        let places: Vec<(f64, f64)> = curve.points.iter().filter(good).map(|p| (x.at(p.0), y.at(p.1))).collect();
        let line: Vec<String> = places.iter().map(|p| format!("{:.1},{:.1}", p.0, p.1)).collect();
        writeln!(out, "<polyline fill=\"none\" {style} points=\"{}\"/>", line.join(" "))?;
        for (cx, cy) in places {
            writeln!(out, "<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"3\" fill=\"{color}\"/>")?;
        }
        let (lx, ly) = (right + 16.0, top + 14.0 + 21.0 * row as f64);
        writeln!(out, "<line x1=\"{lx}\" x2=\"{}\" y1=\"{ly}\" y2=\"{ly}\" {style}/>", lx + 30.0)?;
        writeln!(out, "<circle cx=\"{}\" cy=\"{ly}\" r=\"3\" fill=\"{color}\"/>", lx + 15.0)?;
        writeln!(out, "<text x=\"{}\" y=\"{}\">{}</text>", lx + 38.0, ly + 4.5, escape(&curve.name))?;
    }
    writeln!(out, "</svg>")
}

/// A tick's value, without digits it does not have.
fn number(value: f64) -> String {
    let exponent = value.log10().floor() as i32;
    if (-4..5).contains(&exponent) {
        format!("{value:.*}", usize::try_from(-exponent).unwrap_or(0))
    } else {
        format!("{:.0}e{exponent}", value / 10f64.powi(exponent))
    }
}

fn escape(text: &str) -> String {
    let clean: String = text.chars().filter(|c| !c.is_control()).collect();
    clean.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_where_the_values_say() {
        let axis = Axis::new([0.3, 30.0].into_iter(), 0.0, 100.0);
        assert_eq!((axis.low, axis.high), (0.2, 50.0));
        assert!((axis.at(0.2) - 0.0).abs() < 1e-9 && (axis.at(10f64.sqrt()) - 50.0).abs() < 1e-9);
        let labels: Vec<String> = axis.ticks().iter().filter(|t| t.1).map(|t| number(t.0)).collect();
        assert_eq!(labels, ["0.2", "0.5", "1", "2", "5", "10", "20", "50"]);
        // A single value and none at all still make an axis.
        assert!(Axis::new([1.0].into_iter(), 0.0, 1.0).at(1.0).is_finite());
        assert!(Axis::new(std::iter::empty(), 0.0, 1.0).at(1.0).is_finite());
        assert_eq!([number(2e-7), number(1e6), number(0.001)], ["2e-7", "1e6", "0.001"]);
    }

    #[test]
    fn what_has_no_logarithm_is_left_out() {
        let curves = [Curve {
            name: "a<b & c".into(),
            color: 0,
            dash: 1,
            points: vec![(1.0, -1.0), (1.0, 2.0), (f64::NAN, 1.0), (2.0, 1.0)],
        }];
        let text = svg(&Plot { title: "t", x: "x", y: "y", goal: Some(0.01), curves: &curves });
        assert!(!text.contains("NaN") && !text.contains("inf") && text.contains("a&lt;b &amp; c"));
        assert_eq!(text.matches("<circle").count(), 3);
    }
}
