//! Definitions and bodies of messages, all treated as hostile; the readable form of well-known types.

use authros::model::clean;
use authros::ros::readable::{place, read};
use authros::ros::robot::{COMPRESSED_IMAGE, ODOMETRY, compressed_image_definition, odometry_definition};
use authros::ros::{Definition, Limits};

use crate::{Sample, sample, way};

const WAYS: u8 = 3;

const HEADER: &str = "\n================================================================================\nMSG: std_msgs/Header\n\
    uint32 seq\ntime stamp\nstring frame_id";

/// Types whose readable form is tried, with their own lines.
const KNOWN: [(&str, &str); 6] = [
    (
        "sensor_msgs/LaserScan",
        "Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
        float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities",
    ),
    (
        "sensor_msgs/JointState",
        "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    ),
    (
        "sensor_msgs/PointCloud2",
        "Header header\nuint32 height\nuint32 width\nF[] fields\nbool is_bigendian\n\
        uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n\
        ================================================================================\nMSG: sensor_msgs/F\n\
        string name\nuint32 offset\nuint8 datatype\nuint32 count",
    ),
    (
        "sensor_msgs/BatteryState",
        "Header header\nfloat32 voltage\nfloat32 percentage\nuint8 power_supply_status\n\
        uint8 power_supply_health\nbool present\nfloat32[] cell_voltage",
    ),
    (
        "sensor_msgs/NavSatFix",
        "Header header\nint8 status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n\
        float64[9] position_covariance\nuint8 position_covariance_type",
    ),
    ("sensor_msgs/Imu", "Header header\nfloat64[9] orientation_covariance\nfloat64[9] angular_velocity_covariance"),
];

/// Any claimed message.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => any_definition(bytes),
        Some((1, bytes)) => simulated(bytes),
        Some((2, bytes)) => known(bytes),
        _ => false,
    }
}

/// Length of the definition (2, big endian), definition, body.
fn any_definition(bytes: &[u8]) -> bool {
    let Some((length, rest)) = bytes.split_first_chunk::<2>() else { return false };
    let Some((text, body)) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length))) else { return false };
    let Ok(text) = std::str::from_utf8(text) else { return false };
    let Ok(definition) = Definition::parse("a/T", text) else { return false };
    assert_eq!(definition.md5sum().len(), 32);
    tried(&definition, body)
}

/// Decoded, flattened, written as JSON: all of it or nothing, and nothing unsafe for a terminal.
fn tried(definition: &Definition, body: &[u8]) -> bool {
    let mut json = Vec::new();
    let written = definition.write_json(body, &mut json).is_ok();
    let decoded = definition.decode(body, Limits { elements: 64, steps: 50_000 });
    if let Ok(value) = &decoded {
        assert!(value.flatten(usize::MAX).iter().all(|(path, text)| is_clean(path) && is_clean(text)));
        serde_json::to_string(value).expect("JSON");
    }
    if written {
        let text = std::str::from_utf8(&json).expect("UTF-8");
        assert!(is_clean(text), "what a terminal must not see");
        serde_json::from_str::<serde::de::IgnoredAny>(text).expect("JSON");
    }
    if let Some(matrix) = definition.matrix(body) {
        let length = matrix.length().expect("one that can be coded");
        assert!(matrix.start + length <= body.len(), "within the message");
    }
    written && decoded.is_ok()
}

fn is_clean(text: &str) -> bool {
    clean(text, usize::MAX) == text
}

fn simulated(bytes: &[u8]) -> bool {
    let types = [(ODOMETRY, odometry_definition()), (COMPRESSED_IMAGE, compressed_image_definition())];
    let tried = types.map(|(name, text)| {
        let definition = Definition::parse(name, &text).expect("a definition");
        let fits = tried(&definition, bytes);
        assert_eq!(read(&definition, bytes).is_some(), fits, "readable where it fits");
        place(&definition, bytes);
        fits
    });
    tried.contains(&true)
}

/// Number of the type (1), body.
fn known(bytes: &[u8]) -> bool {
    let Some((number, body)) = bytes.split_first() else { return false };
    let (name, text) = KNOWN[usize::from(*number) % KNOWN.len()];
    let definition = Definition::parse(name, &format!("{text}{HEADER}")).expect("a definition");
    tried(&definition, body);
    place(&definition, body);
    let Some(readable) = read(&definition, body) else { return false };
    let mut cells = readable.tables.iter().flat_map(|table| table.rows.iter().flatten());
    assert!(readable.lines.iter().all(|(_, value)| is_clean(value)) && cells.all(|cell| is_clean(cell)));
    let points = readable.plot.map(|plot| plot.points).unwrap_or_default();
    assert!(points.len() <= authros::ros::readable::MOST_POINTS && points.iter().all(|point| point.0.is_finite()));
    true
}

/// Valid messages of every kind.
pub fn samples() -> Vec<Sample> {
    let header = [&[0; 12][..], &[4, 0, 0, 0], b"odom"].concat();
    let odometry = [&header[..], &[4, 0, 0, 0], b"base", &[0; 680]].concat();
    let text = b"Part[] parts\nstring[2] names\ntime at\nuint8[] data\n================================================================================\nMSG: a/Part\nfloat32 x\nint8 K=3";
    let body =
        [&[1, 0, 0, 0, 0, 0, 128, 63][..], &[1, 0, 0, 0, b'a', 0, 0, 0, 0], &[0; 8], &[2, 0, 0, 0, 1, 2]].concat();
    let length = u16::try_from(text.len()).expect("short").to_be_bytes();
    let scan = [&[0][..], &header, &[0; 28], &[2, 0, 0, 0, 0, 0, 128, 63, 0, 0, 0, 64], &[0; 4]].concat();
    let joints = [&[1][..], &header, &[1, 0, 0, 0, 1, 0, 0, 0, b'a'], &[0; 12]].concat();
    vec![
        sample("any", 0, &[&length[..], text, &body].concat()),
        sample("odometry", 1, &odometry),
        sample("compressed", 1, &[&header[..], &[4, 0, 0, 0], b"jpeg", &[2, 0, 0, 0, 255, 216]].concat()),
        sample("scan", 2, &scan),
        sample("joints", 2, &joints),
    ]
}
