//! Figures of the page, as SVG. Their colours are the page's, so that they follow light and dark.

use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::{escape, put};
use crate::model::Timestamp;
use crate::ros::readable::Plot;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 340.0;
/// Above the plot, and on its right.
const EDGE: f64 = 24.0;
/// On the left of the plot, with figures.
const LEFT: f64 = 80.0;
/// Below it, with figures.
const FOOT: f64 = 44.0;

pub(super) fn data_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

fn finite(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite() && x.abs() < 1e12 && y.abs() < 1e12)
}

fn ends(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    let (least, most) = numbers.fold((f64::MAX, f64::MIN), |(least, most), one| (least.min(one), most.max(one)));
    if most > least { (least, most) } else { (least - 1.0, least + 1.0) }
}

/// A span of this length with the same middle.
fn around((least, most): (f64, f64), length: f64) -> (f64, f64) {
    let middle = f64::midpoint(least, most);
    (middle - length / 2.0, middle + length / 2.0)
}

/// To a thousandth, as short as that can be.
fn figure(number: f64) -> String {
    format!("{number:.3}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Places in metres: a metre is as long on both axes, and a path has a start and an end.
fn is_map(axes: &(String, String)) -> bool {
    axes.0.ends_with(", m") && axes.1.ends_with(", m")
}

/// What a plot spans, across and up.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn of(points: &[(f64, f64)], axes: &(String, String)) -> Self {
        let (wide, high) = (WIDTH - LEFT - EDGE, HEIGHT - FOOT - EDGE);
        let (x, y) = (ends(points.iter().map(|point| point.0)), ends(points.iter().map(|point| point.1)));
        if !is_map(axes) {
            return Self { x, y };
        }
        let scale = ((x.1 - x.0) / wide).max((y.1 - y.0) / high);
        Self { x: around(x, scale * wide), y: around(y, scale * high) }
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let across = LEFT + (x - self.x.0) / (self.x.1 - self.x.0) * (WIDTH - LEFT - EDGE);
        let down = HEIGHT - FOOT - (y - self.y.0) / (self.y.1 - self.y.0) * (HEIGHT - FOOT - EDGE);
        (across, down)
    }

    fn axes(&self, out: &mut String, axes: &(String, String)) {
        let (right, base, under, beside) = (WIDTH - EDGE, HEIGHT - FOOT, HEIGHT - FOOT + 16.0, LEFT - 6.0);
        let corner = format!("{LEFT},{EDGE} {LEFT},{base} {right},{base}");
        put!(out, "<polyline class=\"axis\" points=\"{corner}\"/>\n");
        for (place, anchor, text) in [
            ((LEFT, under), "start", figure(self.x.0)),
            ((right, under), "end", figure(self.x.1)),
            ((f64::midpoint(LEFT, right), under + 14.0), "middle", axes.0.clone()),
            ((beside, base), "end", figure(self.y.0)),
            ((beside, EDGE + 8.0), "end", figure(self.y.1)),
            ((LEFT, EDGE - 8.0), "start", axes.1.clone()),
        ] {
            label(out, place, anchor, &text);
        }
    }
}

fn label(out: &mut String, (across, down): (f64, f64), anchor: &str, text: &str) {
    let text = escape(text);
    put!(out, "<text x=\"{across:.1}\" y=\"{down:.1}\" text-anchor=\"{anchor}\">{text}</text>\n");
}

fn circle(out: &mut String, (across, down): (f64, f64), class: &str, radius: f64) {
    put!(out, "<circle cx=\"{across:.1}\" cy=\"{down:.1}\" r=\"{radius}\" class=\"{class}\"/>\n");
}

pub(super) fn plot(out: &mut String, plot: &Plot) {
    let points: Vec<(f64, f64)> = finite(&plot.points).collect();
    let here: Vec<(f64, f64)> = finite(plot.here.as_slice()).collect();
    let all: Vec<(f64, f64)> = points.iter().chain(&here).copied().collect();
    // A single place in an empty frame says nothing new.
    if all.iter().all(|point| all.first() == Some(point)) {
        return;
    }
    let frame = Frame::of(&all, &plot.axes);
    put!(out, "<p class=\"title\">{}</p>\n", escape(&plot.title));
    put!(out, "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\">\n");
    frame.axes(out, &plot.axes);
    let places: Vec<(f64, f64)> = points.iter().map(|point| frame.place(*point)).collect();
    if plot.path {
        let path: Vec<String> = places.iter().map(|(across, down)| format!("{across:.1},{down:.1}")).collect();
        put!(out, "<polyline fill=\"none\" class=\"line\" points=\"{}\"/>\n", path.join(" "));
    } else {
        places.iter().for_each(|place| circle(out, *place, "dot", 1.2));
    }
    here.iter().for_each(|point| circle(out, frame.place(*point), "here", 4.0));
    if let (true, [first, .., last]) = (plot.path && is_map(&plot.axes), places.as_slice()) {
        for (place, text) in [(first, "start"), (last, "end")] {
            circle(out, *place, "dot", 3.0);
            label(out, (place.0, place.1 - 7.0), "middle", text);
        }
    }
    out.push_str("</svg>\n");
}

/// Pieces of the timeline.
const PIECES: u64 = 90;
const PIECE: u64 = 5;
const LABEL: u64 = 230;
/// On either side of the timeline.
const SIDE: u64 = 8;
const ROW: u64 = 24;

/// How many records each topic has over the time, one row for each, and when its owner noted something.
pub(super) fn timeline(out: &mut String, topics: &[(String, Vec<Timestamp>)], notes: &[Timestamp]) {
    let all = || topics.iter().flat_map(|(_, times)| times);
    let Some((first, last)) = all().copied().min().zip(all().copied().max()) else { return };
    let length = (last.0 - first.0).saturating_add(1);
    let piece_of = |at: Timestamp| u128::from(at.0 - first.0) * u128::from(PIECES) / u128::from(length);
    let (width, height) = (LABEL + PIECES * PIECE + SIDE, ROW * topics.len() as u64 + ROW);
    let noted: Vec<Timestamp> = notes.iter().copied().filter(|at| (first..=last).contains(at)).collect();
    let legend = if noted.is_empty() { "" } else { "; a line marks a note" };
    put!(
        out,
        "<p class=\"title\">Timeline: disclosed records by time of capture, as their owner claims it{legend}</p>\n"
    );
    put!(out, "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\">\n");
    for (row, (name, times)) in (0..).zip(topics) {
        let mut counts = vec![0_u64; usize::try_from(PIECES).unwrap_or_default()];
        for time in times {
            if let Some(count) = usize::try_from(piece_of(*time)).ok().and_then(|place| counts.get_mut(place)) {
                *count += 1;
            }
        }
        let (most, base) = (counts.iter().copied().max().unwrap_or(1).max(1), ROW * (row + 1));
        put!(out, "<text x=\"{SIDE}\" y=\"{}\">{}</text>\n", base - 5, escape(name));
        for (piece, count) in (0_u64..).zip(counts).filter(|(_, count)| *count > 0) {
            let (x, tall) = (LABEL + piece * PIECE, (count * (ROW - 4) / most).max(2));
            let y = base - tall;
            put!(out, "<rect class=\"bar\" x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{tall}\"/>\n", PIECE - 1);
        }
    }
    for at in noted {
        let x = u128::from(LABEL) + piece_of(at) * u128::from(PIECE) + 2;
        put!(out, "<line class=\"note\" x1=\"{x}\" x2=\"{x}\" y1=\"0\" y2=\"{}\"/>\n", height - ROW);
    }
    let (base, end) = (height - 7, width - SIDE);
    put!(out, "<text x=\"{LABEL}\" y=\"{base}\">{}</text>\n", first.in_utc());
    put!(out, "<text x=\"{end}\" y=\"{base}\" text-anchor=\"end\">{}</text>\n</svg>\n", last.clock());
}

/// A field over time.
pub(super) fn series(name: &str, numbers: &[(Timestamp, f64)]) -> Option<Plot> {
    let (begin, _) = numbers.first()?;
    let seconds = |at: &Timestamp| Duration::from_nanos(at.0.saturating_sub(begin.0)).as_secs_f64();
    let points = numbers.iter().map(|(at, number)| (seconds(at), *number)).collect();
    let axes = ("seconds".to_owned(), name.to_owned());
    Some(Plot { title: name.to_owned(), axes, points, path: true, here: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(data_uri(bytes.as_bytes()), format!("data:image/png;base64,{text}"));
        }
    }

    #[test]
    fn a_plot_has_every_point_within_its_frame_and_its_names_are_escaped() {
        let shown = Plot {
            title: "<script>alert(1)</script>".into(),
            axes: ("x\"".into(), "<y>".into()),
            points: vec![(0.0, 0.0), (f64::NAN, 1.0), (1e300, 0.0), (2.0, 4.0)],
            path: true,
            here: Some((2.0, 4.0)),
        };
        let mut out = String::new();
        plot(&mut out, &shown);
        assert!(
            out.contains("points=\"80.0,296.0 616.0,24.0\"") && out.contains("cx=\"616.0\" cy=\"24.0\" r=\"4\""),
            "{out}"
        );
        assert!(!out.contains("<script") && !out.contains("NaN") && out.contains("&lt;y&gt;"), "{out}");
        let mut nothing = String::new();
        plot(&mut nothing, &Plot { points: vec![(f64::NAN, 0.0)], ..Plot::default() });
        plot(&mut nothing, &Plot { points: vec![(1.0, 2.0)], here: Some((1.0, 2.0)), ..Plot::default() });
        assert_eq!(nothing, "", "one place is no plot");
    }

    #[test]
    fn a_timeline_has_a_bar_for_each_piece_of_time_with_records_and_hostile_names_stay_text() {
        let at = |second: u64| Timestamp::from_seconds(1_700_000_000 + second);
        let rows = [("</svg><script>".to_owned(), vec![at(0), at(1), at(180)]), ("/odom".to_owned(), vec![at(90)])];
        let mut out = String::new();
        timeline(&mut out, &rows, &[at(0), at(90), at(181)]);
        // Two of the first topic's records share a piece of two seconds.
        assert_eq!(out.matches("<rect").count(), 3, "{out}");
        assert!(!out.contains("<script") && out.contains("&lt;/svg&gt;&lt;script&gt;"), "{out}");
        assert!(out.contains("2023-11-14 22:13:20 UTC") && out.contains(">22:16:20<"), "{out}");
        assert_eq!(out.matches("<line").count(), 2, "the last note is behind the last record: {out}");
        // The last record is in the last piece, which is as long as the others.
        assert!(out.contains("x=\"675\"") && out.contains("<line class=\"note\" x1=\"452\""), "{out}");
        let mut none = String::new();
        timeline(&mut none, &[], &[]);
        assert_eq!(none, "");
    }

    #[test]
    fn a_map_has_one_scale_and_names_its_ends() {
        let axes = ("x, m".to_owned(), "y, m".to_owned());
        let shown = Plot { axes, points: vec![(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], path: true, ..Plot::default() };
        let mut out = String::new();
        plot(&mut out, &shown);
        // 272 for a metre, in the middle of 536.
        assert!(out.contains("points=\"212.0,296.0 484.0,296.0 484.0,24.0\""), "{out}");
        assert!(out.contains(">start<") && out.contains(">end<") && out.contains(">-0.485<"), "{out}");
        let mut other = String::new();
        plot(&mut other, &Plot { axes: ("seconds".into(), "battery".into()), ..shown });
        assert!(
            !other.contains(">start<") && other.contains("points=\"80.0,296.0 616.0,296.0 616.0,24.0\""),
            "{other}"
        );
        assert_eq!([0.0, -3.6354, 100.0, 0.05].map(figure), ["0", "-3.635", "100", "0.05"]);
    }

    #[test]
    fn a_series_begins_at_zero_seconds() {
        let at = |second: u64| Timestamp::from_seconds(1_700_000_000 + second);
        let plot = series("battery", &[(at(5), 0.5), (at(7), 0.25)]).expect("a plot");
        assert_eq!((plot.points, plot.axes.1.as_str()), (vec![(0.0, 0.5), (2.0, 0.25)], "battery"));
        assert_eq!(series("battery", &[]), None);
    }
}
