//! The elements of an SVG document used by plots. Text is escaped, and every number is finite.

use std::fmt::Write as _;

use authros_model::clean;

/// The longest text, characters.
const LONGEST: usize = 400;

/// A text's anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A text's style.
#[derive(Debug, Clone, Copy)]
pub(super) struct Text {
    pub size: f64,
    pub colour: &'static str,
    pub anchor: Anchor,
    pub bold: bool,
    /// Rotated, to be read from below.
    pub upright: bool,
}

impl Default for Text {
    fn default() -> Self {
        Self { size: 11.0, colour: "#222222", anchor: Anchor::Start, bold: false, upright: false }
    }
}

/// A document being written.
pub(super) struct Canvas(String);

impl Canvas {
    /// Of that size, white.
    pub fn new(width: f64, height: f64, title: &str) -> Self {
        let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
        let _infallible = writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" \
             font-family=\"Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif\">\n\
             <title>{}</title>",
            escaped(title)
        );
        let mut canvas = Self(out);
        canvas.rectangle(0.0, 0.0, (width, height), "#ffffff", 1.0);
        canvas
    }

    /// The document.
    pub fn end(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    /// A filled rectangle of (width, height) by its upper left corner.
    pub fn rectangle(&mut self, x: f64, y: f64, (width, height): (f64, f64), colour: &str, opacity: f64) {
        let [x, y, width, height] = [x, y, width.max(0.0), height.max(0.0)].map(finite);
        let _infallible = writeln!(
            self.0,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{colour}\" \
             fill-opacity=\"{opacity}\"/>"
        );
    }

    /// A line through points.
    pub fn line(&mut self, points: &[(f64, f64)], colour: &str, width: f64) {
        let points: Vec<String> = points.iter().map(|(x, y)| format!("{:.1},{:.1}", finite(*x), finite(*y))).collect();
        let _infallible = writeln!(
            self.0,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>",
            points.join(" ")
        );
    }

    /// A dot.
    pub fn dot(&mut self, x: f64, y: f64, colour: &str) {
        let _infallible =
            writeln!(self.0, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.6\" fill=\"{colour}\"/>", finite(x), finite(y));
    }

    /// A line of text, with its baseline at `y`.
    pub fn text(&mut self, x: f64, y: f64, words: &str, look: Text) {
        let (x, y) = (finite(x), finite(y));
        let anchor = match look.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let weight = if look.bold { " font-weight=\"bold\"" } else { "" };
        let turn = if look.upright { format!(" transform=\"rotate(-90 {x:.1} {y:.1})\"") } else { String::new() };
        let _infallible = writeln!(
            self.0,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{}\" fill=\"{}\" text-anchor=\"{anchor}\"{weight}{turn}>{}</text>",
            look.size,
            look.colour,
            escaped(words)
        );
    }
}

fn finite(number: f64) -> f64 {
    if number.is_finite() { number } else { 0.0 }
}

/// The approximate width of a text of that size.
pub(super) fn width_of(words: &str, size: f64) -> f64 {
    crate::spread::number(words.chars().count()) * size * 0.55
}

/// As much of a text as fits that width.
pub(super) fn fitted(words: &str, size: f64, width: f64) -> String {
    if width_of(words, size) <= width {
        return words.to_owned();
    }
    let mut kept: String = words.to_owned();
    while !kept.is_empty() && width_of(&kept, size) + size > width {
        kept.pop();
    }
    format!("{}…", kept.trim_end())
}

/// For content and attributes; characters not allowed in XML are removed.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in clean(text, LONGEST).chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\u{fffe}' | '\u{ffff}' => {}
            other => out.push(other),
        }
    }
    out
}
