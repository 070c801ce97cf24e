//! Every type of ROS 2 Jazzy compared with rosbags, CDR of both versions with Cyclone DDS;
//! `tests/peers/ros2_messages.py` generated the reference.

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use serde_json::{Value as Json, json};

use super::*;
use crate::ros::message::{Limits, Value};

#[derive(Deserialize)]
struct Fixture {
    types: Vec<Type>,
    second_version: SecondVersion,
}

#[derive(Deserialize)]
struct Type {
    name: String,
    text: String,
    hash: String,
    samples: Vec<Sample>,
}

#[derive(Deserialize)]
struct Sample {
    body: String,
    value: Json,
}

#[derive(Deserialize)]
struct SecondVersion {
    name: String,
    text: String,
    bodies: Vec<Body>,
    value: Json,
}

#[derive(Deserialize)]
struct Body {
    about: String,
    body: String,
}

fn fixture() -> Fixture {
    serde_json::from_str(include_str!("jazzy.json")).expect("the fixture")
}

fn bytes(text: &str) -> Vec<u8> {
    STANDARD.decode(text).expect("base64")
}

/// A type's text with all texts it needs, in no particular order.
fn closure(name: &str, texts: &BTreeMap<&str, &str>) -> String {
    let (mut known, mut waiting, mut whole) = (vec![name.to_owned()], vec![name.to_owned()], String::new());
    while let Some(next) = waiting.pop() {
        let own = texts[next.as_str()];
        if next != name {
            whole += &format!("{}\nMSG: {}\n", "=".repeat(80), next.replace("/msg/", "/"));
        }
        whole += own;
        for base in own.lines().filter_map(|line| line.split_whitespace().next()) {
            let base = base.split(['[', '<']).next().expect("a type").replacen('/', "/msg/", 1);
            if texts.contains_key(base.as_str()) && !known.contains(&base) {
                known.push(base.clone());
                waiting.push(base);
            }
        }
    }
    whole
}

fn json_of(definition: &Definition, body: &[u8]) -> Json {
    let mut out = Vec::new();
    definition.write_json(body, &mut out).expect("fits");
    serde_json::from_slice(&out).expect("JSON")
}

#[test]
fn every_type_of_jazzy_has_the_hash_and_the_values_that_others_find() {
    let fixture = fixture();
    let texts: BTreeMap<&str, &str> =
        fixture.types.iter().map(|kind| (kind.name.as_str(), kind.text.as_str())).collect();
    assert_eq!(texts.len(), 162);
    for kind in &fixture.types {
        let text = closure(&kind.name, &texts);
        assert_eq!(type_hash(&kind.name, &text).as_ref(), Ok(&kind.hash), "{}", kind.name);
        let definition = Definition::parse_ros2(&kind.name, &text).expect("a definition");
        for (sample, first) in kind.samples.iter().zip([1, 0]) {
            let body = bytes(&sample.body);
            assert_eq!(body[1], first, "one in each order of bytes");
            assert_eq!(json_of(&definition, &body), sample.value, "{}", kind.name);
            let shown = definition.decode(&body, Limits::default()).expect("fits").to_json().to_string();
            let shown: Json = serde_json::from_str(&shown).expect("JSON");
            let plain = sample.value.to_string().is_ascii();
            assert!(!plain || shown == sample.value, "{}: {shown}", kind.name);
        }
    }
}

/// The expected hashes are rosbags', over its own texts.
#[test]
fn what_is_built_in_has_the_hashes_and_the_fields_that_others_find() {
    let none = Folders::default();
    for kind in fixture().types {
        let (text, source) = none.text_of(&kind.name).expect("built in");
        assert_eq!(source, Source::BuiltIn);
        assert_eq!(type_hash(&kind.name, &text).as_ref(), Ok(&kind.hash), "{}", kind.name);
        let definition = Definition::parse_ros2(&kind.name, &text).expect("a definition");
        for sample in &kind.samples {
            assert_eq!(json_of(&definition, &bytes(&sample.body)), sample.value, "{}", kind.name);
        }
    }
    assert!(none.may_know("std_msgs/String") && !none.may_know("std_msgs/msg/Strings"));
    assert!(none.text_of("std_msgs/msg/Strings").expect_err("unknown").to_string().contains("nor built"));
}

#[test]
fn hashes_are_those_that_ros_2_publishes() {
    let known = [
        ("std_msgs/msg/String", "string data", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        ("std_msgs/msg/Empty", "", "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312"),
    ];
    let discovery = "Gid gid\nNodeEntitiesInfo[] node_entities_info_seq\n====================\nMSG: rmw_dds_common/Gid\n\
        char[16] data\n====================\nMSG: rmw_dds_common/NodeEntitiesInfo\nstring<=256 node_namespace\n\
        string<=256 node_name\nGid[] reader_gid_seq\nGid[] writer_gid_seq\n";
    let announced = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e";
    assert_eq!(type_hash("rmw_dds_common/msg/ParticipantEntitiesInfo", discovery).as_deref(), Ok(announced));
    for (name, text, hash) in known {
        assert_eq!(type_hash(name, text), Ok(format!("RIHS01_{hash}")), "{name}");
    }
    // Neither comments nor constants nor default values count, bounds do.
    let hash = |text: &str| type_hash("a/msg/T", text).expect("a definition");
    assert_eq!(hash("uint8 K=3 # three\nstring s \"x\" # why\nchar c"), hash("string s\nuint8 c"));
    assert_ne!(hash("string<=5 s"), hash("string s"));
    assert_ne!(hash("byte c"), hash("uint8 c"));
}

#[test]
fn both_versions_of_cdr_in_both_orders_of_bytes() {
    let SecondVersion { name, text, bodies, value } = fixture().second_version;
    let definition = Definition::parse_ros2(&name, &text).expect("a definition");
    assert_eq!(bodies.len(), 8);
    let kinds: std::collections::BTreeSet<u8> = bodies.iter().map(|body| bytes(&body.body)[1]).collect();
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), [0, 1, 6, 7, 8, 9]);
    for Body { about, body } in &bodies {
        let mut body = bytes(body);
        assert_eq!(json_of(&definition, &body), value, "{about}");
        body.extend([0; 3]);
        assert_eq!(json_of(&definition, &body), value, "{about}, filled up");
        body.push(0);
        assert!(definition.decode(&body, Limits::default()).is_err(), "{about}, too long");
    }
}

#[test]
fn a_newer_definition_may_have_added_members_at_the_end() {
    let definition = Definition::parse_ros2("a/msg/T", "uint8 one").expect("a definition");
    let body = [0, 9, 0, 0, 8, 0, 0, 0, 7, 1, 2, 3, 4, 5, 6, 7];
    assert_eq!(json_of(&definition, &body), json!({"one": 7}));
    let lying = [0, 9, 0, 0, 0, 0, 0, 0, 7];
    assert!(definition.decode(&lying, Limits::default()).is_err());
}

/// Wide texts as laid out by Fast CDR 2, Cyclone DDS and Fast CDR 1.
#[test]
fn wide_texts_of_every_middleware() {
    let definition = Definition::parse_ros2("a/msg/T", "wstring<=9 text\nuint8 after").expect("a definition");
    let units: Vec<u16> = "机é".encode_utf16().collect();
    let two: Vec<u8> = units.iter().flat_map(|unit| unit.to_le_bytes()).collect();
    let four: Vec<u8> = units.iter().flat_map(|unit| u32::from(*unit).to_le_bytes()).collect();
    for (length, text) in [(4, &two), (2, &two), (2, &four)] {
        let body = [&[0, 1, 0, 0, length, 0, 0, 0][..], text, &[9]].concat();
        assert_eq!(json_of(&definition, &body), json!({"text": "机é", "after": 9}), "{body:?}");
    }
    let big: Vec<u8> = units.iter().flat_map(|unit| unit.to_be_bytes()).collect();
    let body = [&[0, 0, 0, 0, 0, 0, 0, 4][..], &big, &[9]].concat();
    assert_eq!(json_of(&definition, &body), json!({"text": "机é", "after": 9}));
    let big: Vec<u8> = units.iter().flat_map(|unit| u32::from(*unit).to_be_bytes()).collect();
    let body = [&[0, 0, 0, 0, 0, 0, 0, 2][..], &big, &[9]].concat();
    assert_eq!(json_of(&definition, &body), json!({"text": "机é", "after": 9}));
    assert!(definition.decode(&[0, 1, 0, 0, 3, 0, 0, 0, 1, 2], Limits::default()).is_err());
}

#[test]
fn long_arrays_say_where_they_lie_and_in_which_order() {
    let definition = Definition::parse_ros2("a/msg/T", "uint8 first\nfloat64[] numbers").expect("a definition");
    for (kind, start) in [(0, 12), (1, 12), (6, 12), (7, 12)] {
        let count = if kind % 2 == 1 { 2000_u32.to_le_bytes() } else { 2000_u32.to_be_bytes() };
        let body = [&[0, kind, 0, 0, 5, 0, 0, 0][..], &count, &[0; 16_000]].concat();
        let value = definition.decode(&body, Limits::default()).expect("fits");
        let bytes = start..start + 16_000;
        let large = Value::Large { element: "float64".into(), count: 2000, bytes, big_endian: kind % 2 == 0 };
        assert_eq!(value.get("numbers"), Some(&large), "{kind}");
    }
}

#[test]
fn what_a_recording_may_carry_besides() {
    let text = "uint8 x\n================================================================================\nIDL: a/msg/P\nmodule a {};";
    assert!(Definition::parse_ros2("a/msg/T", text).expect_err("IDL").to_string().contains("IDL"));
    let text = "msg/P p\n";
    assert!(Definition::parse_ros2("a/msg/T", text).is_err());
    let full = "P p\nb/msg/Q q\n====================\nMSG: a/msg/P\nuint8 x\n====================\nMSG: b/Q\nint8 y";
    let definition = Definition::parse_ros2("a/T", full).expect("a definition");
    assert_eq!((definition.type_name(), definition.short_name().as_str()), ("a/msg/T", "a/T"));
    assert_eq!(json_of(&definition, &[0, 1, 0, 0, 3, 255]), json!({"p": {"x": 3}, "q": {"y": -1}}));
    let empty = Definition::parse_ros2("std_msgs/msg/Empty", "# nothing").expect("a definition");
    assert_eq!(json_of(&empty, &[0, 1, 0, 0, 0]), json!({}));
    assert!(empty.decode(&[0, 1, 0, 0], Limits::default()).is_err());
    let event = "Call_Request[<=1] request\n====================\nMSG: a/msg/Call_Request\nuint8 x";
    assert!(Definition::parse_ros2("a/srv/Call_Event", event).is_ok());
}
