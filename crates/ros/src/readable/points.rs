//! Scans, clouds and paths: their figures, and their points from above.

use super::motion::metres;
use super::numbers::{Body, count, float, floats, number, shown, stamp, text};
use super::{MOST_POINTS, Plot, Readable, Table};
use crate::model::clean;
use crate::ros::message::Value;

pub(super) fn scan(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    let (least, most) = (float(value, "range_min").unwrap_or(0.0), float(value, "range_max").unwrap_or(f64::INFINITY));
    let (first, step) = (float(value, "angle_min").unwrap_or(0.0), float(value, "angle_increment").unwrap_or(0.0));
    let ranges = floats(value, "ranges", body, usize::MAX);
    let valid = |range: &f64| range.is_finite() && *range >= least && *range <= most;
    let good = ranges.iter().map(|(_, range)| *range).filter(valid);
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    let degrees = |path: &str| float(value, path).map_or_else(|| String::from("-"), |angle| number(angle.to_degrees()));
    out.line("Angles", format!("{}° to {}°", degrees("angle_min"), degrees("angle_max")));
    out.line("Range", format!("{} to {} m", number(least), number(most)));
    out.line("Beams", format!("{}, of these {} in range", ranges.len(), good.clone().count()));
    out.line("Scan time, s", shown(value, "scan_time"));
    let nearest = good.clone().fold(f64::INFINITY, f64::min);
    let farthest = good.fold(0.0, f64::max);
    if nearest.is_finite() {
        out.line("Nearest, farthest", format!("{}, {}", metres(nearest), metres(farthest)));
    }
    let every = ranges.len().div_ceil(MOST_POINTS).max(1);
    let point = |(at, range): &(usize, f64)| {
        let angle = first + step * f64::from(u32::try_from(*at).unwrap_or(u32::MAX));
        (range * angle.cos(), range * angle.sin())
    };
    let shown = ranges.iter().filter(|(_, range)| valid(range)).step_by(every);
    out.plot = plot("Scan from above", shown.map(point).collect(), Some((0.0, 0.0)), false);
    out
}

fn plot(title: &str, points: Vec<(f64, f64)>, here: Option<(f64, f64)>, path: bool) -> Option<Plot> {
    let points: Vec<(f64, f64)> = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let axes = (String::from("x, m"), String::from("y, m"));
    (!points.is_empty()).then(|| Plot { title: title.to_owned(), axes, points, path, here })
}

/// One field of a cloud's points.
struct Part {
    name: String,
    offset: usize,
    kind: usize,
    count: usize,
}

const KINDS: [&str; 9] = ["?", "int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"];

pub(super) fn cloud(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    let parts = parts(value);
    let (columns, rows) = (count(value, "width").unwrap_or(0), count(value, "height").unwrap_or(0));
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    out.line("Points", format!("{} ({columns} x {rows})", columns.saturating_mul(rows)));
    out.line("Bytes of a point", text(value, "point_step"));
    out.line("Dense", if count(value, "is_dense") == Some(1) { "yes" } else { "no: points may be missing" });
    let head = ["field", "offset", "type", "count"].map(String::from).to_vec();
    let cells = parts.iter().map(|part| {
        let kind = KINDS.get(part.kind).copied().unwrap_or("?").to_owned();
        vec![part.name.clone(), part.offset.to_string(), kind, part.count.to_string()]
    });
    out.tables.push(Table { title: String::from("Fields"), head, rows: cells.collect() });
    let points = seen_from_above(value, body, &parts).unwrap_or_default();
    if let Some((low, high)) = heights(&points) {
        out.line("Heights", format!("{} to {}", metres(low), metres(high)));
    }
    let flat = points.into_iter().map(|(x, y, _)| (x, y)).collect();
    out.plot = plot("Cloud from above", flat, Some((0.0, 0.0)), false);
    out
}

fn parts(value: &Value) -> Vec<Part> {
    let Some(Value::Array(items)) = value.get("fields") else { return Vec::new() };
    let part = |item: &Value| {
        let Some(Value::Text(name)) = item.get("name") else { return None };
        let (offset, kind, many) = (count(item, "offset")?, count(item, "datatype")?, count(item, "count")?);
        Some(Part { name: clean(name, 40), offset, kind, count: many })
    };
    items.iter().take(64).filter_map(part).collect()
}

fn heights(points: &[(f64, f64, f64)]) -> Option<(f64, f64)> {
    let heights = points.iter().map(|(_, _, z)| *z).filter(|z| z.is_finite());
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    (low <= high).then_some((low, high))
}

/// x, y and z of a sample of the points.
fn seen_from_above(value: &Value, body: &Body, parts: &[Part]) -> Option<Vec<(f64, f64, f64)>> {
    let big = count(value, "is_bigendian")? != 0;
    let step = count(value, "point_step").filter(|step| *step > 0)?;
    let data = bytes(value.get("data")?, body)?;
    let axis = |name: &str| parts.iter().find(|part| part.name == name && matches!(part.kind, 7 | 8));
    let (x, y, z) = (axis("x")?, axis("y")?, axis("z"));
    let points = data.len() / step;
    let every = points.div_ceil(MOST_POINTS).max(1);
    let read = |point: &[u8], part: &Part| coordinate(point.get(part.offset..)?, part.kind == 8, big);
    let point = |point: &[u8]| {
        let height = z.and_then(|z| read(point, z)).unwrap_or(f64::NAN);
        Some((read(point, x)?, read(point, y)?, height)).filter(|(x, y, _)| x.is_finite() && y.is_finite())
    };
    Some(data.chunks_exact(step).step_by(every).filter_map(point).collect())
}

fn coordinate(bytes: &[u8], wide: bool, big: bool) -> Option<f64> {
    if wide {
        let bytes = *bytes.first_chunk::<8>()?;
        return Some(if big { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) });
    }
    let bytes = *bytes.first_chunk::<4>()?;
    Some(f64::from(if big { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) }))
}

/// The bytes of an array of bytes.
pub(super) fn bytes<'a>(value: &Value, body: &'a Body) -> Option<std::borrow::Cow<'a, [u8]>> {
    match value {
        Value::Large { bytes, .. } => body.0.get(bytes.clone()).map(std::borrow::Cow::Borrowed),
        Value::Array(items) => {
            let byte = |item: &Value| match item {
                Value::Unsigned(number) => u8::try_from(*number).ok(),
                _ => None,
            };
            items.iter().map(byte).collect::<Option<Vec<u8>>>().map(std::borrow::Cow::Owned)
        }
        _ => None,
    }
}

pub(super) fn path(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    let Some(Value::Array(poses)) = value.get("poses") else { return out };
    out.line("Poses", poses.len().to_string());
    let point = |pose: &Value| Some((float(pose, "pose.position.x")?, float(pose, "pose.position.y")?));
    out.plot = plot("Path", poses.iter().filter_map(point).collect(), None, true);
    out
}
