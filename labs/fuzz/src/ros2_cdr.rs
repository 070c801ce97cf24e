//! ROS 2 definitions and bodies, all treated as hostile.

use authros::model::clean;
use authros::ros::message::type_hash;
use authros::ros::readable::{place, read};
use authros::ros::{Definition, Limits};

use crate::{Sample, sample, way};

const WAYS: u8 = 2;

const RULE: &str = "\n================================================================================\nMSG: ";

const HEADER: &str = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id";

const TIME: &str = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec";

/// Types whose readable form is tried, with their own lines.
const KNOWN: [(&str, &str); 5] = [
    (
        "sensor_msgs/msg/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
        float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities",
    ),
    (
        "sensor_msgs/msg/Image",
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data",
    ),
    (
        "sensor_msgs/msg/JointState",
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    ),
    ("sensor_msgs/msg/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data"),
    (
        "a/msg/Wide",
        "wstring<=9 one\nwstring[] more\nE[] nothing\n\
        ================================================================================\nMSG: a/E",
    ),
];

/// Any claimed ROS 2 message.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => any_definition(bytes),
        Some((1, bytes)) => known(bytes),
        _ => false,
    }
}

/// Length of the definition (2, big endian), definition, body.
fn any_definition(bytes: &[u8]) -> bool {
    let Some((length, rest)) = bytes.split_first_chunk::<2>() else { return false };
    let Some((text, body)) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length))) else { return false };
    let Ok(text) = std::str::from_utf8(text) else { return false };
    let Ok(definition) = Definition::parse_ros2("a/msg/T", text) else { return false };
    assert_eq!(type_hash("a/msg/T", text).expect("parsed before").len(), 71);
    tried(&definition, body)
}

/// Decoded, flattened, written as JSON: all of it or nothing, and nothing unsafe for a terminal.
fn tried(definition: &Definition, body: &[u8]) -> bool {
    let mut json = Vec::new();
    let written = definition.write_json(body, &mut json).is_ok();
    let decoded = definition.decode(body, Limits { elements: 64, steps: 50_000 });
    if let Ok(value) = &decoded {
        let rows = value.flatten(usize::MAX);
        assert!(rows.iter().all(|(path, text)| is_clean(path) && is_clean(text)));
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

/// Number of the type (1), body.
fn known(bytes: &[u8]) -> bool {
    let Some((number, body)) = bytes.split_first() else { return false };
    let (name, text) = KNOWN[usize::from(*number) % KNOWN.len()];
    let definition = Definition::parse_ros2(name, &format!("{text}{RULE}{HEADER}{RULE}{TIME}")).expect("a definition");
    let fits = tried(&definition, body);
    place(&definition, body);
    if let Some(readable) = read(&definition, body) {
        assert!(readable.lines.iter().all(|(_, value)| is_clean(value)));
        let points = readable.plot.map(|plot| plot.points).unwrap_or_default();
        assert!(points.iter().all(|point| point.0.is_finite() && point.1.is_finite()));
    }
    fits
}

/// Valid messages in each kind of CDR.
pub fn samples() -> Vec<Sample> {
    let text = b"P[] parts\nstring[2] names\nfloat64 x\n\
        ================================================================================\nMSG: a/P\nuint8 k\nint8 K=3";
    let length = u16::try_from(text.len()).expect("short").to_be_bytes();
    let any = |body: &[u8]| [&length[..], text, body].concat();
    let names = [2, 0, 0, 0, b'a', 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0];
    let first = [&[0, 1, 0, 0, 1, 0, 0, 0, 7, 0, 0, 0][..], &names, &[0; 8]].concat();
    let names_of_big = [0, 0, 0, 2, b'a', 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0];
    let big = [&[0, 0, 0, 0, 0, 0, 0, 1, 7, 0, 0, 0][..], &names_of_big, &[0; 8]].concat();
    let second = [&[0, 7, 0, 0, 5, 0, 0, 0, 1, 0, 0, 0, 7, 0, 0, 0, 13, 0, 0, 0][..], &names, &[0; 8]].concat();
    let header = [&[0, 1, 0, 0][..], &[0; 8], &[5, 0, 0, 0], b"odom\0", &[0; 3]].concat();
    let scan = [&[0][..], &header, &[0; 28], &[2, 0, 0, 0, 0, 0, 128, 63, 0, 0, 0, 64], &[0; 4]].concat();
    let wide = [4, 0, 1, 0, 0, 4, 0, 0, 0, b'a', 0, b'b', 0, 0, 0, 0, 0, 1, 0, 0, 0, 0];
    vec![
        sample("first", 0, &any(&first)),
        sample("big", 0, &any(&big)),
        sample("second", 0, &any(&second)),
        sample("scan", 1, &scan),
        sample("wide", 1, &wide),
    ]
}
