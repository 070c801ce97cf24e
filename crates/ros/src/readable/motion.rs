//! Where a robot is and how it moves: Odometry with the paper's LV, AV, Pose, Cov, TS and Type in full words, Imu, NavSatFix.

use super::numbers::{Body, count, float, number, shown, square, stamp, text, triple, turned};
use super::{Plot, Readable};
use crate::ros::message::Value;

const POSE: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
const AXES: [&str; 3] = ["x", "y", "z"];

/// The earth's mean radius, metres.
const EARTH: f64 = 6_371_008.8;

pub(super) fn odometry(value: &Value, _: &Body) -> Readable {
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
    out.plot = here("Position", ("x, m", "y, m"), value, ("pose.pose.position.x", "pose.pose.position.y"));
    out
}

fn here(title: &str, axes: (&str, &str), value: &Value, paths: (&str, &str)) -> Option<Plot> {
    let point = (float(value, paths.0)?, float(value, paths.1)?);
    let finite = point.0.is_finite() && point.1.is_finite();
    finite.then(|| Plot {
        title: title.to_owned(),
        axes: (axes.0.to_owned(), axes.1.to_owned()),
        points: vec![point],
        path: true,
        here: Some(point),
    })
}

pub(super) fn inertia(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    let known = |path: &str| match value.get(path) {
        // REP 145: -1 in the first element = not measured.
        Some(Value::Array(items)) => !matches!(items.first(), Some(Value::Float(first)) if *first < 0.0),
        _ => true,
    };
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    let unless = |known: bool, shown: String| if known { shown } else { String::from("not measured") };
    out.line("Orientation", unless(known("orientation_covariance"), turned(value, "orientation")));
    out.line(
        "Angular velocity, rad/s",
        unless(known("angular_velocity_covariance"), triple(value, "angular_velocity")),
    );
    out.line(
        "Acceleration, m/s²",
        unless(known("linear_acceleration_covariance"), triple(value, "linear_acceleration")),
    );
    for (title, path) in [
        ("Orientation covariance", "orientation_covariance"),
        ("Angular velocity covariance", "angular_velocity_covariance"),
        ("Acceleration covariance", "linear_acceleration_covariance"),
    ] {
        out.tables.extend(square(title, &AXES, value, path));
    }
    out
}

pub(super) fn fix(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    let degrees = |path: &str| float(value, path).map_or_else(|| String::from("-"), |degrees| format!("{degrees:.7}°"));
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    out.line("Fix", fix_word(value));
    out.line("Latitude", degrees("latitude"));
    out.line("Longitude", degrees("longitude"));
    out.line("Altitude, m", shown(value, "altitude"));
    let kind = match count(value, "position_covariance_type") {
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
    let services = count(value, "status.service").unwrap_or(0);
    let named = [(1, "GPS"), (2, "GLONASS"), (4, "BeiDou"), (8, "Galileo")];
    let names: Vec<&str> = named.iter().filter(|(bit, _)| services & bit != 0).map(|(_, name)| *name).collect();
    if names.is_empty() { word.to_owned() } else { format!("{word} ({})", names.join(", ")) }
}

/// Metres east and north of `from`, both in degrees of longitude and latitude; good for some kilometres.
pub(super) fn around(from: (f64, f64), to: (f64, f64)) -> (f64, f64) {
    let east = (to.0 - from.0).to_radians() * from.1.to_radians().cos() * EARTH;
    (east, (to.1 - from.1).to_radians() * EARTH)
}

/// A length in readable form.
pub(super) fn metres(length: f64) -> String {
    format!("{} m", number(length))
}
