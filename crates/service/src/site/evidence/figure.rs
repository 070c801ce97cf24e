//! Drawings of a report: plots as SVG, pictures as data within the page.

use std::fmt::Write as _;

use super::page::escape;
use crate::ros::readable::Plot;

/// Size of a plot, and the space around it.
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;
const EDGE: f64 = 24.0;

/// The bytes of a PNG as a data URL.
pub(super) fn data_uri(png: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = "data:image/png;base64,".to_owned();
    for three in png.chunks(3) {
        let bits = three.iter().fold(0u32, |bits, byte| bits << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for at in 0..4usize {
            let letter = LETTERS.get((bits >> (18 - 6 * at) & 63) as usize).copied().unwrap_or(b'A');
            out.push(if at > three.len() { '=' } else { char::from(letter) });
        }
    }
    out
}

/// Points that can be drawn.
fn finite(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite() && x.abs() < 1e12 && y.abs() < 1e12)
}

/// The minimum and the maximum, never equal.
fn ends(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    let (least, most) = numbers.fold((f64::MAX, f64::MIN), |(least, most), one| (least.min(one), most.max(one)));
    if most > least { (least, most) } else { (least - 1.0, least + 1.0) }
}

/// A plot, with the end points of its axes.
pub(super) fn plot(out: &mut String, plot: &Plot) {
    let points: Vec<(f64, f64)> = finite(&plot.points).collect();
    let here: Vec<(f64, f64)> = finite(plot.here.as_slice()).collect();
    let all = || points.iter().chain(&here);
    // A single place in an empty frame says nothing that its numbers do not.
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
    let mut svg = format!(
        "<p class=\"title\">{}</p>\n<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\">\n",
        escape(&plot.title)
    );
    if plot.path {
        let _infallible = writeln!(svg, "<polyline fill=\"none\" stroke=\"#036\" points=\"{}\"/>", path.join(" "));
    }
    let dots = path.iter().filter(|_| !plot.path).map(|at| (at.clone(), "#036", 1.2));
    for (at, colour, radius) in dots.chain(here.iter().map(|point| (place(point), "#a00", 4.0))) {
        let (across, down) = at.split_once(',').unwrap_or(("0", "0"));
        let _infallible = writeln!(svg, "<circle cx=\"{across}\" cy=\"{down}\" r=\"{radius}\" fill=\"{colour}\"/>");
    }
    let (across, up) = (escape(&plot.axes.0), escape(&plot.axes.1));
    let _infallible =
        writeln!(svg, "</svg>\n<p>{across}: {:.3} to {:.3}; {up}: {:.3} to {:.3}</p>", x.0, x.1, y.0, y.1);
    out.push_str(&svg);
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
}
