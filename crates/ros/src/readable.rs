//! Messages of well-known types in readable form: lines of numbers, tables, a plot, a picture. Every other type is
//! shown as its tree of fields. All texts here are clean; everything is bounded, whatever the message claims.

mod codec;
mod matrix;
mod motion;
mod numbers;
mod picture;
mod points;
mod raster;
mod state;

use serde::{Deserialize, Serialize};

pub use codec::{DECODER_MEMORY, MOST_PIXELS, Rgb, decode};
pub use picture::{Exported, PictureError, export, file_of};
pub use raster::Raster;

use super::message::{Definition, Limits, Value};
use numbers::Body;

/// The most rows of a table.
pub const MOST_ROWS: usize = 200;

/// The most points of a plot.
pub const MOST_POINTS: usize = 4_000;

/// A message in readable form.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Readable {
    /// Label and value.
    pub lines: Vec<(String, String)>,
    /// Matrices and lists.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tables: Vec<Table>,
    /// Points to plot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plot: Option<Plot>,
    /// A thumbnail of the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<Raster>,
}

/// A matrix or list.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Table {
    /// Its title.
    pub title: String,
    /// Columns; may be empty.
    pub head: Vec<String>,
    /// Rows of cells.
    pub rows: Vec<Vec<String>>,
}

/// Points in a plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Plot {
    /// Its title.
    pub title: String,
    /// Names and units of both axes.
    pub axes: (String, String),
    /// Points, in order.
    pub points: Vec<(f64, f64)>,
    /// Whether the points are a path.
    pub path: bool,
    /// A highlighted point: the robot, or this record on its path.
    pub here: Option<(f64, f64)>,
}

impl Readable {
    /// Adds a line.
    fn line(&mut self, label: &str, value: impl Into<String>) {
        self.lines.push((label.to_owned(), value.into()));
    }
}

/// Reads `body`; `None` if its type is not a well-known one, or it does not match its definition.
pub fn read(definition: &Definition, body: &[u8]) -> Option<Readable> {
    let reader = reader_of(&definition.short_name())?;
    let value = definition.decode(body, Limits { elements: 512, ..Limits::default() }).ok()?;
    Some(reader(&value, &Body(body)))
}

type Reader = fn(&Value, &Body) -> Readable;

fn reader_of(type_name: &str) -> Option<Reader> {
    Some(match type_name {
        "nav_msgs/Odometry" => motion::odometry,
        "sensor_msgs/Imu" => motion::inertia,
        "sensor_msgs/NavSatFix" => motion::fix,
        "sensor_msgs/LaserScan" => points::scan,
        "sensor_msgs/PointCloud2" => points::cloud,
        "nav_msgs/Path" => points::path,
        "sensor_msgs/JointState" => state::joints,
        "tf2_msgs/TFMessage" | "tf/tfMessage" => state::transforms,
        "sensor_msgs/BatteryState" => state::battery,
        "diagnostic_msgs/DiagnosticArray" => state::diagnostics,
        "sensor_msgs/CompressedImage" => picture::compressed,
        "sensor_msgs/Image" => picture::raw,
        _ => return None,
    })
}

/// A robot's position: metres in the plane for poses; longitude and latitude in degrees for fixes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// x and y, metres.
    Metres(f64, f64),
    /// Longitude and latitude, degrees.
    Degrees(f64, f64),
}

/// The position in a message whose type has one; `None` for other types.
pub fn place(definition: &Definition, body: &[u8]) -> Option<Place> {
    let path = match definition.short_name().as_str() {
        "nav_msgs/Odometry" | "geometry_msgs/PoseWithCovarianceStamped" => "pose.pose.position",
        "geometry_msgs/PoseStamped" => "pose.position",
        "geometry_msgs/TransformStamped" => "transform.translation",
        "geometry_msgs/PointStamped" => "point",
        "sensor_msgs/NavSatFix" => "",
        _ => return None,
    };
    let value = definition.decode(body, Limits::default()).ok()?;
    let at = |name: &str| numbers::float(&value, &if path.is_empty() { name.into() } else { format!("{path}.{name}") });
    let place = if path.is_empty() { (at("longitude")?, at("latitude")?) } else { (at("x")?, at("y")?) };
    let finite = place.0.is_finite() && place.1.is_finite();
    let degrees = path.is_empty();
    finite.then_some(if degrees { Place::Degrees(place.0, place.1) } else { Place::Metres(place.0, place.1) })
}

/// The path over several records, in order; `here` is one of them. Degrees become metres around the first.
pub fn track(title: &str, places: &[Place], here: Option<Place>) -> Option<Plot> {
    let origin = places.iter().find_map(|place| match place {
        Place::Degrees(longitude, latitude) => Some((*longitude, *latitude)),
        Place::Metres(..) => None,
    });
    let flat = |place: &Place| match (place, origin) {
        (Place::Metres(x, y), _) => (*x, *y),
        (Place::Degrees(longitude, latitude), Some(from)) => motion::around(from, (*longitude, *latitude)),
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

#[cfg(test)]
mod tests;
