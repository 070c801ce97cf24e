//! Figures of the page, as SVG. Their colours are the page's, so that they follow light and dark.

use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::{escape, put};
use crate::model::Timestamp;
use crate::ros::readable::Plot;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;
const EDGE: f64 = 24.0;

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

pub(super) fn plot(out: &mut String, plot: &Plot) {
    let points: Vec<(f64, f64)> = finite(&plot.points).collect();
    let here: Vec<(f64, f64)> = finite(plot.here.as_slice()).collect();
    let all = || points.iter().chain(&here);
    // A single place in an empty frame says nothing new.
    if all().all(|point| all().next() == Some(point)) {
        return;
    }
    let (x, y) = (ends(all().map(|point| point.0)), ends(all().map(|point| point.1)));
    let place = |point: &(f64, f64)| {
        let across = EDGE + (point.0 - x.0) / (x.1 - x.0) * (WIDTH - 2.0 * EDGE);
        let down = HEIGHT - EDGE - (point.1 - y.0) / (y.1 - y.0) * (HEIGHT - 2.0 * EDGE);
        format!("{across:.1},{down:.1}")
    };
    let path: Vec<String> = points.iter().map(place).collect();
    put(out, format_args!("<p class=\"title\">{}</p>\n", escape(&plot.title)));
    put(out, format_args!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\">\n"));
    if plot.path {
        put(out, format_args!("<polyline fill=\"none\" class=\"line\" points=\"{}\"/>\n", path.join(" ")));
    }
    let dots = path.iter().filter(|_| !plot.path).map(|at| (at.clone(), "dot", 1.2));
    for (at, class, radius) in dots.chain(here.iter().map(|point| (place(point), "here", 4.0))) {
        let (across, down) = at.split_once(',').unwrap_or(("0", "0"));
        put(out, format_args!("<circle cx=\"{across}\" cy=\"{down}\" r=\"{radius}\" class=\"{class}\"/>\n"));
    }
    let (across, up) = (escape(&plot.axes.0), escape(&plot.axes.1));
    let ends = format!("{across}: {:.3} to {:.3}; {up}: {:.3} to {:.3}", x.0, x.1, y.0, y.1);
    put(out, format_args!("</svg>\n<p>{ends}</p>\n"));
}

/// Pieces of the timeline.
const PIECES: u64 = 90;
const PIECE: u64 = 5;
const LABEL: u64 = 240;
const ROW: u64 = 24;

/// How many records each topic has over the time, one row for each.
pub(super) fn timeline(out: &mut String, topics: &[(String, Vec<Timestamp>)]) {
    let all = || topics.iter().flat_map(|(_, times)| times);
    let Some((first, last)) = all().min().zip(all().max()) else { return };
    let length = (last.0 - first.0).max(1);
    let (width, height) = (LABEL + PIECES * PIECE, ROW * topics.len() as u64 + ROW);
    out.push_str(
        "<p class=\"title\">Timeline: disclosed records over the time of capture, as their owner claims it</p>\n",
    );
    put(out, format_args!("<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\">\n"));
    for (row, (name, times)) in (0..).zip(topics) {
        let mut counts = vec![0_u64; usize::try_from(PIECES).unwrap_or_default()];
        for time in times {
            let place = u128::from(time.0 - first.0) * u128::from(PIECES - 1) / u128::from(length);
            if let Some(count) = usize::try_from(place).ok().and_then(|place| counts.get_mut(place)) {
                *count += 1;
            }
        }
        let (most, base) = (counts.iter().copied().max().unwrap_or(1).max(1), ROW * (row + 1));
        put(out, format_args!("<text x=\"0\" y=\"{}\">{}</text>\n", base - 5, escape(name)));
        for (piece, count) in (0_u64..).zip(counts).filter(|(_, count)| *count > 0) {
            let (x, tall) = (LABEL + piece * PIECE, (count * (ROW - 4) / most).max(2));
            let y = base - tall;
            put(
                out,
                format_args!("<rect class=\"bar\" x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{tall}\"/>\n", PIECE - 1),
            );
        }
    }
    let (base, end) = (height - 6, width);
    put(out, format_args!("<text x=\"{LABEL}\" y=\"{base}\">{}</text>\n", first.in_milliseconds()));
    put(out, format_args!("<text x=\"{end}\" y=\"{base}\" text-anchor=\"end\">{}</text>\n</svg>\n", last.clock()));
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
            out.contains("points=\"24.0,296.0 536.0,24.0\"") && out.contains("cx=\"536.0\" cy=\"24.0\" r=\"4\""),
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
        timeline(&mut out, &rows);
        // Two of the first topic's records share a piece of two seconds.
        assert_eq!(out.matches("<rect").count(), 3, "{out}");
        assert!(!out.contains("<script") && out.contains("&lt;/svg&gt;&lt;script&gt;"), "{out}");
        assert!(out.contains("2023-11-14T22:13:20.000Z") && out.contains(">22:16:20<"), "{out}");
        let mut none = String::new();
        timeline(&mut none, &[]);
        assert_eq!(none, "");
    }

    #[test]
    fn a_series_begins_at_zero_seconds() {
        let at = |second: u64| Timestamp::from_seconds(1_700_000_000 + second);
        let plot = series("battery", &[(at(5), 0.5), (at(7), 0.25)]).expect("a plot");
        assert_eq!((plot.points, plot.axes.1.as_str()), (vec![(0.0, 0.5), (2.0, 0.25)], "battery"));
        assert_eq!(series("battery", &[]), None);
    }
}
