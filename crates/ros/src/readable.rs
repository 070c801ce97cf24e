//! Messages of well-known types in readable form: lines of numbers, tables, a plot, a picture. All texts are clean, and
//! everything is bounded, whatever the message claims.

mod picture;

use crate::model::{Timestamp, clean};
use crate::ros::message::{Definition, Limits, Value, layout};
use picture::{bytes, coordinate, plot};
use serde::{Deserialize, Serialize};

pub use picture::{DECODER_MEMORY, Exported, MOST_PIXELS, PictureError, Raster, decode, export, file_of};

pub const MOST_ROWS: usize = 200;

pub const MOST_POINTS: usize = 4_000;

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Readable {
    pub lines: Vec<(String, String)>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tables: Vec<Table>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plot: Option<Plot>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<Raster>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Table {
    pub title: String,
    /// May be empty.
    pub head: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Plot {
    pub title: String,
    /// Names and units.
    pub axes: (String, String),
    pub points: Vec<(f64, f64)>,
    pub path: bool,
    /// A highlighted point: the robot, or this record on its path.
    pub here: Option<(f64, f64)>,
}

impl Readable {
    /// With the header's stamp and frame.
    fn headed(value: &Value) -> Self {
        let mut out = Self::default();
        out.line("Stamp (UTC)", stamp(value));
        out.line("Frame", text(value, "header.frame_id"));
        out
    }

    fn line(&mut self, label: &str, value: impl Into<String>) {
        self.lines.push((label.to_owned(), value.into()));
    }
}

/// `None` if its type is not a well-known one, or it does not match its definition.
pub fn read(definition: &Definition, body: &[u8]) -> Option<Readable> {
    let reader = reader_of(&definition.short_name())?;
    let value = definition.decode(body, Limits { elements: 512, ..Limits::default() }).ok()?;
    Some(reader(&value, &Body(body)))
}

type Reader = fn(&Value, &Body) -> Readable;

fn reader_of(type_name: &str) -> Option<Reader> {
    Some(match type_name {
        "nav_msgs/Odometry" => odometry,
        "sensor_msgs/Imu" => inertia,
        "sensor_msgs/NavSatFix" => fix,
        "sensor_msgs/LaserScan" => picture::scan,
        "sensor_msgs/PointCloud2" => picture::cloud,
        "nav_msgs/Path" => picture::path,
        "sensor_msgs/JointState" => joints,
        "tf2_msgs/TFMessage" | "tf/tfMessage" => transforms,
        "sensor_msgs/BatteryState" => battery,
        "diagnostic_msgs/DiagnosticArray" => diagnostics,
        "sensor_msgs/CompressedImage" => picture::compressed,
        "sensor_msgs/Image" => picture::raw,
        _ => return None,
    })
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    Metres(f64, f64),
    /// Longitude and latitude.
    Degrees(f64, f64),
}

/// `None` for types without a position.
pub fn place(definition: &Definition, body: &[u8]) -> Option<Place> {
    let (path, names) = match definition.short_name().as_str() {
        "nav_msgs/Odometry" | "geometry_msgs/PoseWithCovarianceStamped" => ("pose.pose.position.", ["x", "y"]),
        "geometry_msgs/PoseStamped" => ("pose.position.", ["x", "y"]),
        "geometry_msgs/TransformStamped" => ("transform.translation.", ["x", "y"]),
        "geometry_msgs/PointStamped" => ("point.", ["x", "y"]),
        "sensor_msgs/NavSatFix" => ("", ["longitude", "latitude"]),
        _ => return None,
    };
    let value = definition.decode(body, Limits::default()).ok()?;
    let [one, other] = names.map(|name| float(&value, &format!("{path}{name}")).filter(|number| number.is_finite()));
    Some(if path.is_empty() { Place::Degrees(one?, other?) } else { Place::Metres(one?, other?) })
}

/// `here` is one of the places. Degrees become metres around the first.
pub fn track(title: &str, places: &[Place], here: Option<Place>) -> Option<Plot> {
    let origin = places.iter().find_map(|place| match place {
        Place::Degrees(longitude, latitude) => Some((*longitude, *latitude)),
        Place::Metres(..) => None,
    });
    let flat = |place: &Place| match (place, origin) {
        (Place::Metres(x, y), _) => (*x, *y),
        (Place::Degrees(longitude, latitude), Some(from)) => around(from, (*longitude, *latitude)),
        (Place::Degrees(longitude, latitude), None) => (*longitude, *latitude),
    };
    let axes = if origin.is_some() { ("east, m", "north, m") } else { ("x, m", "y, m") };
    let points: Vec<(f64, f64)> = places.iter().take(MOST_POINTS).map(flat).collect();
    (!points.is_empty()).then(|| Plot {
        title: title.to_owned(),
        axes: (axes.0.to_owned(), axes.1.to_owned()),
        points,
        path: true,
        here: here.as_ref().map(flat),
    })
}

/// The message's bytes, for arrays that were not expanded.
struct Body<'a>(pub &'a [u8]);

fn float(value: &Value, path: &str) -> Option<f64> {
    as_float(value.get(path)?)
}

#[allow(clippy::cast_precision_loss, reason = "for the eye")]
fn as_float(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        Value::Unsigned(number) => Some(*number as f64),
        Value::Bool(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    }
}

fn text(value: &Value, path: &str) -> String {
    match value.get(path) {
        Some(Value::Text(text)) => clean(text, 120),
        Some(stamp @ Value::Message(_)) if seconds(stamp).is_some() => seconds(stamp).unwrap_or_default(),
        Some(other) => other.flatten(1).into_iter().next().map(|(_, text)| text).unwrap_or_default(),
        None => String::from("-"),
    }
}

/// The header's stamp as a date and as it was sent.
fn stamp(value: &Value) -> String {
    let sent = text(value, "header.stamp");
    let dated = sent.split_once('.').and_then(|(seconds, rest)| {
        let date = Timestamp::from_seconds(seconds.parse::<u32>().ok()?.into()).to_string();
        Some(format!("{}.{}Z ({sent})", date.trim_end_matches('Z'), rest.get(..3)?))
    });
    dated.unwrap_or(sent)
}

/// A time or duration of ROS 2, in the form of ROS 1.
fn seconds(value: &Value) -> Option<String> {
    let (Value::Integer(seconds), Value::Unsigned(nanoseconds)) = (value.get("sec")?, value.get("nanosec")?) else {
        return None;
    };
    Some(format!("{seconds}.{nanoseconds:09}"))
}

fn shown(value: &Value, path: &str) -> String {
    float(value, path).map_or_else(|| String::from("-"), number)
}

fn triple(value: &Value, path: &str) -> String {
    let part = |name: &str| shown(value, &format!("{path}.{name}"));
    format!("x {}  y {}  z {}", part("x"), part("y"), part("z"))
}

/// Four decimals; very small and very large numbers with an exponent.
fn number(number: f64) -> String {
    let size = number.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) {
        return format!("{number:.3e}");
    }
    let text = format!("{number:.4}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { String::from("0") } else { short.to_owned() }
}

/// At most `most` floats of a field, evenly spread, with their places.
fn floats(value: &Value, path: &str, body: &Body, most: usize) -> Vec<(usize, f64)> {
    match value.get(path) {
        Some(Value::Array(items)) => {
            let step = items.len().div_ceil(most.max(1)).max(1);
            items.iter().enumerate().step_by(step).filter_map(|(at, item)| Some((at, as_float(item)?))).collect()
        }
        Some(Value::Large { element, count, bytes, big_endian }) => {
            large((element, *big_endian), *count, body.0.get(bytes.clone()), most)
        }
        _ => Vec::new(),
    }
}

fn large((element, big_endian): (&str, bool), count: usize, bytes: Option<&[u8]>, most: usize) -> Vec<(usize, f64)> {
    let wide = match element {
        "float32" => false,
        "float64" => true,
        _ => return Vec::new(),
    };
    let chunks = bytes.unwrap_or_default().chunks_exact(if wide { 8 } else { 4 });
    let numbered = chunks.enumerate().step_by(count.div_ceil(most.max(1)).max(1));
    numbered.filter_map(|(at, chunk)| Some((at, coordinate(chunk, wide, big_endian)?))).collect()
}

fn square(title: &str, names: &[&str], value: &Value, path: &str) -> Option<Table> {
    let Some(Value::Array(items)) = value.get(path) else { return None };
    let side = names.len();
    if items.len() != side * side {
        return None;
    }
    let cell = |item: &Value| as_float(item).map_or_else(|| String::from("-"), number);
    let rows = items
        .chunks(side)
        .zip(names)
        .map(|(row, name)| std::iter::once((*name).to_owned()).chain(row.iter().map(cell)).collect());
    let head = std::iter::once(String::new()).chain(names.iter().map(|name| (*name).to_owned()));
    Some(Table { title: title.to_owned(), head: head.collect(), rows: rows.collect() })
}

/// The title counts the left-out items.
fn listed(title: &str, head: &[&str], value: &Value, path: &str, row: impl Fn(&Value) -> Vec<String>) -> Table {
    let (rows, all): (Vec<_>, _) = match value.get(path) {
        Some(Value::Array(items)) => (items.iter().take(MOST_ROWS).map(row).collect(), items.len()),
        Some(Value::Large { count, .. }) => (Vec::new(), *count),
        _ => (Vec::new(), 0),
    };
    let title = if rows.len() < all { format!("{title} ({} of {all})", rows.len()) } else { title.to_owned() };
    Table { title, head: head.iter().map(|name| (*name).to_owned()).collect(), rows }
}

/// Roll, pitch and yaw of a quaternion field, in degrees.
fn angles(value: &Value, path: &str) -> Option<(f64, f64, f64)> {
    let part = |name: &str| float(value, &format!("{path}.{name}"));
    let (x, y, z, w) = (part("x")?, part("y")?, part("z")?, part("w")?);
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    Some((roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees()))
}

fn turned(value: &Value, path: &str) -> String {
    let Some((roll, pitch, yaw)) = angles(value, path) else { return String::from("-") };
    format!("roll {}°  pitch {}°  yaw {}°", number(roll), number(pitch), number(yaw))
}

const POSE: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
const AXES: [&str; 3] = ["x", "y", "z"];

/// Mean radius, metres.
const EARTH: f64 = 6_371_008.8;

fn odometry(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Type", "nav_msgs/Odometry");
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frames", format!("{} -> {}", text(value, "header.frame_id"), text(value, "child_frame_id")));
    out.line("Pose, m", triple(value, "pose.pose.position"));
    out.line("Orientation", turned(value, "pose.pose.orientation"));
    out.line("Linear velocity, m/s", triple(value, "twist.twist.linear"));
    out.line("Angular velocity, rad/s", triple(value, "twist.twist.angular"));
    out.tables.extend(square("Pose covariance", &POSE, value, "pose.covariance"));
    out.tables.extend(square("Twist covariance", &POSE, value, "twist.covariance"));
    let place = float(value, "pose.pose.position.x").zip(float(value, "pose.pose.position.y"));
    out.plot = plot("Position", place.into_iter().collect(), place, true);
    out
}

fn inertia(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::headed(value);
    let known = |path: &str| match value.get(path) {
        // REP 145: -1 in the first element = not measured.
        Some(Value::Array(items)) => !matches!(items.first(), Some(Value::Float(first)) if *first < 0.0),
        _ => true,
    };
    let unless = |known: bool, shown: String| if known { shown } else { String::from("not measured") };
    for (label, title, path, covariance, shown) in [
        ("Orientation", "Orientation", "orientation", "orientation_covariance", turned as fn(&Value, &str) -> String),
        ("Angular velocity, rad/s", "Angular velocity", "angular_velocity", "angular_velocity_covariance", triple),
        ("Acceleration, m/s²", "Acceleration", "linear_acceleration", "linear_acceleration_covariance", triple),
    ] {
        out.line(label, unless(known(covariance), shown(value, path)));
        out.tables.extend(square(&format!("{title} covariance"), &AXES, value, covariance));
    }
    out
}

fn fix(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::headed(value);
    let degrees = |path: &str| float(value, path).map_or_else(|| String::from("-"), |degrees| format!("{degrees:.7}°"));
    out.line("Fix", fix_word(value));
    out.line("Latitude", degrees("latitude"));
    out.line("Longitude", degrees("longitude"));
    out.line("Altitude, m", shown(value, "altitude"));
    let kind = match value.count("position_covariance_type") {
        Some(1) => "approximated",
        Some(2) => "diagonal known",
        Some(3) => "known",
        _ => "unknown",
    };
    out.line("Covariance", kind);
    out.tables.extend(square("Position covariance, m²", &["east", "north", "up"], value, "position_covariance"));
    out
}

fn fix_word(value: &Value) -> String {
    let word = match value.get("status.status") {
        Some(Value::Integer(-1)) => "no fix",
        Some(Value::Integer(0)) => "fix",
        Some(Value::Integer(1)) => "satellite-based augmentation",
        Some(Value::Integer(2)) => "ground-based augmentation",
        _ => "unknown",
    };
    let services = value.count("status.service").unwrap_or(0);
    let named = [(1, "GPS"), (2, "GLONASS"), (4, "BeiDou"), (8, "Galileo")];
    let names: Vec<&str> = named.iter().filter(|(bit, _)| services & bit != 0).map(|(_, name)| *name).collect();
    if names.is_empty() { word.to_owned() } else { format!("{word} ({})", names.join(", ")) }
}

/// Metres east and north of `from`, both in degrees of longitude and latitude; good for some kilometres.
fn around(from: (f64, f64), to: (f64, f64)) -> (f64, f64) {
    let east = (to.0 - from.0).to_radians() * from.1.to_radians().cos() * EARTH;
    (east, (to.1 - from.1).to_radians() * EARTH)
}

fn metres(length: f64) -> String {
    format!("{} m", number(length))
}

fn joints(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    let Some(Value::Array(names)) = value.get("name") else { return out };
    let column = |path: &str| -> Vec<String> {
        floats(value, path, body, usize::MAX).into_iter().map(|(_, value)| number(value)).collect()
    };
    let columns = [column("position"), column("velocity"), column("effort")];
    let rows = names.iter().take(MOST_ROWS).enumerate().map(|(at, name)| {
        let name = if let Value::Text(name) = name { clean(name, 60) } else { String::new() };
        let cells = columns.iter().map(|column| column.get(at).cloned().unwrap_or_else(|| String::from("-")));
        std::iter::once(name).chain(cells).collect()
    });
    let head = ["joint", "position, rad or m", "velocity", "effort"].map(String::from).to_vec();
    out.line("Joints", names.len().to_string());
    out.tables.push(Table { title: String::from("Joints"), head, rows: rows.collect() });
    out
}

fn transforms(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    let head = ["parent", "child", "stamp", "translation, m", "orientation"];
    let table = listed("Transforms", &head, value, "transforms", |item| {
        vec![
            text(item, "header.frame_id"),
            text(item, "child_frame_id"),
            text(item, "header.stamp"),
            triple(item, "transform.translation"),
            turned(item, "transform.rotation"),
        ]
    });
    out.line("Transforms", table.rows.len().to_string());
    out.tables.push(table);
    out
}

fn battery(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    let word = |path: &str, words: &[&str]| -> String {
        let Some(Value::Unsigned(code)) = value.get(path) else { return String::from("-") };
        let known = usize::try_from(*code).ok().and_then(|code| words.get(code));
        known.map_or_else(|| format!("code {code}"), |word| (*word).to_owned())
    };
    out.line("Stamp (UTC)", stamp(value));
    let share = float(value, "percentage").filter(|share| share.is_finite());
    out.line("Charge", share.map_or_else(|| String::from("unknown"), |share| format!("{} %", number(share * 100.0))));
    out.line("Voltage, V", shown(value, "voltage"));
    out.line("Current, A", shown(value, "current"));
    out.line("Temperature, °C", shown(value, "temperature"));
    out.line("Charge, Ah", format!("{} of {}", shown(value, "charge"), shown(value, "capacity")));
    out.line("Status", word("power_supply_status", &["unknown", "charging", "discharging", "not charging", "full"]));
    let health = ["unknown", "good", "overheat", "dead", "overvoltage", "failed", "cold", "watchdog", "safety timer"];
    out.line("Health", word("power_supply_health", &health));
    let present = value.get("present").and_then(as_float).is_some_and(|present| present > 0.0);
    out.line("Present", if present { "yes" } else { "no" });
    let cells: Vec<String> =
        floats(value, "cell_voltage", body, MOST_ROWS).into_iter().map(|(_, cell)| number(cell)).collect();
    if !cells.is_empty() {
        out.line("Cells, V", cells.join("  "));
    }
    out
}

fn diagnostics(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    let head = ["level", "name", "message", "hardware"];
    let table = listed("Status", &head, value, "status", |item| {
        let level = item.count("level").and_then(|level| ["OK", "WARN", "ERROR", "STALE"].get(level).copied());
        let level = level.unwrap_or("?").to_owned();
        vec![level, text(item, "name"), text(item, "message"), text(item, "hardware_id")]
    });
    out.line("Parts", table.rows.len().to_string());
    let values = value.get("status").map(values).unwrap_or_default();
    out.tables.push(table);
    if !values.is_empty() {
        let head = ["part", "key", "value"].map(String::from).to_vec();
        out.tables.push(Table { title: String::from("Values"), head, rows: values });
    }
    out
}

fn values(status: &Value) -> Vec<Vec<String>> {
    let Value::Array(items) = status else { return Vec::new() };
    let pairs = items.iter().flat_map(|item| match item.get("values") {
        Some(Value::Array(pairs)) => pairs.iter().map(|pair| (item, pair)).collect(),
        _ => Vec::new(),
    });
    pairs.take(MOST_ROWS).map(|(item, pair)| vec![text(item, "name"), text(pair, "key"), text(pair, "value")]).collect()
}

struct Matrix<'a> {
    pub width: usize,
    pub height: usize,
    pub encoding: String,
    pub channels: usize,
    pub sample: usize,
    pub big_endian: bool,
    step: usize,
    data: std::borrow::Cow<'a, [u8]>,
}

impl<'a> Matrix<'a> {
    pub fn of(value: &Value, body: &'a Body) -> Result<Self, PictureError> {
        let broken = || PictureError::Broken("its size, step and data do not agree".into());
        let Some(Value::Text(encoding)) = value.get("encoding") else { return Err(broken()) };
        let encoding = clean(encoding, 40);
        let (channels, sample) = layout(&encoding).ok_or_else(|| PictureError::Encoding(encoding.clone()))?;
        let number = |field: &str| value.count(field).ok_or_else(broken);
        let (width, height, step) = (number("width")?, number("height")?, number("step")?);
        let data = value.get("data").and_then(|data| bytes(data, body)).ok_or_else(broken)?;
        let row = width.checked_mul(channels * sample).ok_or_else(broken)?;
        let needed = step.checked_mul(height).ok_or_else(broken)?;
        if row > step || needed > data.len() || row == 0 || height == 0 {
            return Err(broken());
        }
        let big_endian = number("is_bigendian")? != 0;
        Ok(Self { width, height, encoding, channels, sample, big_endian, step, data })
    }

    /// Without padding.
    pub fn row(&self, y: usize) -> &[u8] {
        let start = y * self.step;
        self.data.get(start..start + self.width * self.channels * self.sample).unwrap_or_default()
    }

    fn number(&self, x: usize, y: usize, channel: usize) -> u32 {
        let at = (x * self.channels + channel) * self.sample;
        let row = self.row(y);
        let byte = |offset: usize| u32::from(row.get(at + offset).copied().unwrap_or(0));
        let order = |offset: usize| if self.big_endian { self.sample - 1 - offset } else { offset };
        (0..self.sample).map(|offset| byte(order(offset)) << (8 * offset)).sum()
    }

    /// A number as a float, if the numbers are depths.
    fn depth(&self, x: usize, y: usize) -> f32 {
        let number = self.number(x, y, 0);
        if self.encoding.starts_with("32F") {
            f32::from_bits(number)
        } else if self.sample == 4 {
            // Integer depths never get this large; the difference would not be visible.
            f32::from(u16::try_from(number >> 16).unwrap_or(u16::MAX))
        } else {
            f32::from(u16::try_from(number).unwrap_or(u16::MAX))
        }
    }

    /// Whether numbers are measurements, to be spread over all greys.
    pub fn is_depth(&self) -> bool {
        self.channels == 1 && (self.sample == 4 || self.encoding.starts_with("16"))
    }

    /// Missing measurements (0, NaN, infinite) do not count.
    pub fn depths(&self) -> Option<(f32, f32)> {
        let all = (0..self.height).flat_map(|y| (0..self.width).map(move |x| self.depth(x, y)));
        all.filter(|depth| depth.is_finite() && *depth != 0.0).fold(None, |range, depth| {
            let (low, high) = range.unwrap_or((depth, depth));
            Some((low.min(depth), high.max(depth)))
        })
    }

    pub fn eye(&self) -> Box<dyn Fn(usize, usize) -> [u8; 3] + '_> {
        if self.is_depth() {
            let (low, high) = self.depths().unwrap_or((0.0, 1.0));
            let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
            return Box::new(move |x, y| {
                let depth = self.depth(x, y);
                if depth.is_finite() && depth != 0.0 { [grey((depth - low) * scale); 3] } else { [0; 3] }
            });
        }
        match self.places() {
            Places::Pixel(places) => Box::new(move |x, y| places.map(|channel| self.part(x, y, channel))),
            Places::Bayer(first) => Box::new(move |x, y| self.bayer(x, y, first)),
            Places::Yuv(luma) => Box::new(move |x, y| self.yuv(x, y, luma)),
        }
    }

    fn part(&self, x: usize, y: usize, channel: usize) -> u8 {
        let number = self.number(x, y, channel);
        u8::try_from(number >> (8 * (self.sample - 1))).unwrap_or(u8::MAX)
    }

    fn places(&self) -> Places {
        match self.encoding.as_str() {
            "bayer_rggb8" | "bayer_rggb16" => Places::Bayer((0, 0)),
            "bayer_bggr8" | "bayer_bggr16" => Places::Bayer((1, 1)),
            "bayer_gbrg8" | "bayer_gbrg16" => Places::Bayer((0, 1)),
            "bayer_grbg8" | "bayer_grbg16" => Places::Bayer((1, 0)),
            "yuv422" => Places::Yuv(1),
            "yuv422_yuy2" => Places::Yuv(0),
            encoding if encoding.starts_with("rgb") => Places::Pixel([0, 1, 2]),
            _ if self.channels >= 3 => Places::Pixel([2, 1, 0]),
            _ => Places::Pixel([0; 3]),
        }
    }

    /// Red, one green and blue of the pixel's 2x2 square; `red` = column and row of red in it.
    fn bayer(&self, x: usize, y: usize, red: (usize, usize)) -> [u8; 3] {
        let inside = |x: usize, y: usize| self.part(x.min(self.width - 1), y.min(self.height - 1), 0);
        let (left, top) = (x & !1, y & !1);
        [
            inside(left + red.0, top + red.1),
            inside(left + 1 - red.0, top + red.1),
            inside(left + 1 - red.0, top + 1 - red.1),
        ]
    }

    /// ITU-R BT.601, two pixels sharing their colour.
    fn yuv(&self, x: usize, y: usize, luma: usize) -> [u8; 3] {
        let byte = |at: usize| f32::from(self.row(y).get(at).copied().unwrap_or(128));
        let pair = (x & !1) * 2;
        let light = byte(x * 2 + luma);
        let (u, v) = (byte(pair + 1 - luma) - 128.0, byte(pair + 3 - luma) - 128.0);
        [grey(light + 1.402 * v), grey(light - 0.344 * u - 0.714 * v), grey(light + 1.772 * u)]
    }
}

enum Places {
    Pixel([usize; 3]),
    Bayer((usize, usize)),
    Yuv(usize),
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
fn grey(value: f32) -> u8 {
    value.clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests;
