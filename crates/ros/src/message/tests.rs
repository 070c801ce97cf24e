//! Definitions and bodies, valid and hostile.

use proptest::prelude::*;

use super::*;
use crate::ros::robot::{COMPRESSED_IMAGE, ODOMETRY, compressed_image_definition, odometry_definition};

fn with(root: &str, sections: &[(&str, &str)]) -> String {
    let rule = "=".repeat(80);
    sections.iter().fold(root.to_owned(), |text, (name, body)| format!("{text}\n{rule}\nMSG: {name}\n{body}"))
}

fn parse(text: &str) -> Result<Definition> {
    Definition::parse("a/Root", text)
}

fn decode(text: &str, body: &[u8]) -> Result<Value> {
    parse(text).expect("definition").decode(body, Limits::default())
}

/// Types a/T1 .. a/Tn, each containing the next.
fn chain(length: usize) -> String {
    let names: Vec<String> = (1..=length).map(|level| format!("a/T{level}")).collect();
    let bodies: Vec<String> = (2..=length + 1).map(|level| format!("T{level} below")).collect();
    let mut sections: Vec<(&str, &str)> =
        names.iter().map(String::as_str).zip(bodies.iter().map(String::as_str)).collect();
    if let Some(last) = sections.last_mut() {
        last.1 = "uint8 end";
    }
    with("T1 first", &sections)
}

#[test]
fn every_primitive_little_endian() {
    let definition = "bool a\nint8 b\nbyte b2\nuint8 c\nchar c2\nint16 d\nuint16 e\nint32 f\nuint32 g\nint64 h\nuint64 i\n\
        float32 j\nfloat64 k\nstring l\ntime m\nduration n\nuint8[2] o\nint16[] p\nstring[] q";
    let mut body = vec![1, 255, 254, 200, 201];
    body.extend((-2i16).to_le_bytes());
    body.extend(65_000u16.to_le_bytes());
    body.extend((-3i32).to_le_bytes());
    body.extend(4_000_000_000u32.to_le_bytes());
    body.extend(i64::MIN.to_le_bytes());
    body.extend(u64::MAX.to_le_bytes());
    body.extend(0.5f32.to_le_bytes());
    body.extend(f64::NAN.to_le_bytes());
    body.extend([3, 0, 0, 0]);
    body.extend("h\u{1b}i".bytes());
    body.extend([7, 0, 0, 0, 9, 0, 0, 0]);
    body.extend((-1i32).to_le_bytes());
    body.extend(500_000_000i32.to_le_bytes());
    body.extend([5, 6]);
    body.extend([1, 0, 0, 0, 254, 255]);
    body.extend([2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, b'z']);
    let value = decode(definition, &body).expect("fits");
    let rows: Vec<String> =
        value.flatten(usize::MAX).into_iter().map(|(path, text)| format!("{path}={text}")).collect();
    let expected = "a=true b=-1 b2=-2 c=200 c2=201 d=-2 e=65000 f=-3 g=4000000000 h=-9223372036854775808 \
        i=18446744073709551615 j=0.5 k=NaN l=h\u{fffd}i m=7.000000009 n=-0.500000000 o=[5, 6] p=[-2] q=[, z]";
    assert_eq!(rows.join(" "), expected);
    let json = value.to_json();
    assert_eq!(json["k"], "NaN");
    assert_eq!(json["m"], serde_json::json!({"secs": 7, "nsecs": 9}));
    assert_eq!(json["o"], serde_json::json!([5, 6]));
    let text = serde_json::to_string(&value).expect("json");
    assert!(text.starts_with("{\"a\":true,\"b\":-1,\"b2\":-2,\"c\":200"), "{text}");
    for end in 0..body.len() {
        assert!(decode(definition, &body[..end]).is_err(), "{end}");
    }
}

#[test]
fn truncated_at_every_byte_and_one_too_many() {
    let text = with(
        "Header header\nPart[] parts\nstring note\nfloat64[3] xs",
        &[("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id"), ("a/Part", "string name\nuint8 kind")],
    );
    let mut body = vec![0; 12];
    body.extend([2, 0, 0, 0, b'm', b'p', 2, 0, 0, 0]);
    body.extend([1, 0, 0, 0, b'x', 9, 0, 0, 0, 0, 8]);
    body.extend([0; 4 + 24]);
    let value = decode(&text, &body).expect("fits");
    assert_eq!(value.flatten(usize::MAX)[3], ("parts[0].name".into(), "x".into()));
    for end in 0..body.len() {
        assert!(decode(&text, &body[..end]).is_err(), "{end}");
    }
    body.push(0);
    assert!(decode(&text, &body).is_err());
}

#[test]
fn hostile_definitions() {
    let recursive = with("B b", &[("a/B", "C c"), ("a/C", "B[] b")]);
    assert!(parse(&recursive).expect_err("cycle").to_string().contains("contains itself"));
    assert!(parse(&with("", &[])).is_ok());
    assert!(Definition::parse("a/Root", "Root r").is_err());
    assert!(parse(&chain(DEEPEST - 1)).is_ok());
    let error = parse(&chain(DEEPEST)).expect_err("17 deep");
    assert!(error.to_string().contains("deep"), "{error}");
    assert!(parse("Missing m").expect_err("missing").to_string().contains("a/Missing is missing"));
    assert!(parse(&"#".repeat(LONGEST_DEFINITION + 1)).is_err());
    assert!(parse("uint8[99999999999999999999] x").is_err());
    assert!(Definition::parse("no type", "uint8 x").is_err());
    let many: Vec<String> = (0..600).map(|index| format!("a/T{index}")).collect();
    let many: Vec<(&str, &str)> = many.iter().map(|name| (name.as_str(), "")).collect();
    assert!(parse(&with("", &many)).is_err());
}

/// A deep type reached first by a short path, then by a long one.
#[test]
fn depth_is_that_of_the_longest_way() {
    let short_first = format!("T9 near\n{}", chain(DEEPEST));
    assert!(parse(&short_first).is_err());
    let allowed = format!("T9 near\n{}", chain(DEEPEST - 1));
    assert!(parse(&allowed).is_ok());
}

#[test]
fn counts_without_bytes() {
    let claim = u32::MAX.to_le_bytes();
    for text in ["uint8[] x", "float64[] x", "string[] x", "string x"] {
        assert!(decode(text, &claim).is_err(), "{text}");
    }
    let parts = with("Part[] parts", &[("a/Part", "uint8[1000000] big")]);
    assert!(decode(&parts, &claim).is_err());
    // Elements without size need no bytes: they are counted, not built.
    let empties = with("E[] x", &[("a/E", "")]);
    let value = decode(&empties, &claim).expect("fits");
    assert_eq!(value.flatten(usize::MAX), [("x".to_owned(), "E[4294967295]".to_owned())]);
    let huge =
        with("E[18446744073709551615] x\nE[18446744073709551615] y", &[("a/E", "uint8[18446744073709551615] z")]);
    assert!(decode(&huge, &claim).is_err());
}

#[test]
fn fields_without_bytes_cost_from_the_budget() {
    let names: Vec<String> = (1..DEEPEST).map(|level| format!("a/T{level}")).collect();
    let fields = |level: usize| (0..200).map(|index| format!("T{level} f{index}\n")).collect::<String>();
    let bodies: Vec<String> = (2..DEEPEST).map(fields).chain([String::new()]).collect();
    let sections: Vec<(&str, &str)> = names.iter().map(String::as_str).zip(bodies.iter().map(String::as_str)).collect();
    let bomb = parse(&with(&fields(1), &sections)).expect("small text");
    assert!(bomb.decode(&[], Limits { steps: 100_000, ..Limits::default() }).is_err());
    assert_eq!(bomb.md5sum().len(), 32);
}

#[test]
fn large_arrays_are_summed_up_with_their_place() {
    let mut body = vec![0x10, 0x27, 0, 0];
    body.extend(vec![7; 10_000]);
    body.push(5);
    let value = decode("uint8[] data\nuint8 after", &body).expect("fits");
    assert_eq!(
        value.get("data"),
        Some(&Value::Large { element: "uint8".into(), count: 10_000, bytes: 4..10_004, big_endian: false })
    );
    assert_eq!(value.get("after"), Some(&Value::Unsigned(5)));
    assert_eq!(value.to_json()["data"], "uint8[10000]");
    let mut texts = 2000u32.to_le_bytes().to_vec();
    texts.extend([1, 0, 0, 0, b'a'].repeat(2000));
    let value = decode("string[] names", &texts).expect("fits");
    assert_eq!(
        value.get("names"),
        Some(&Value::Large { element: "string".into(), count: 2000, bytes: 4..10_004, big_endian: false })
    );
}

#[test]
fn md5sums_that_ros_computes() {
    let sum = |name: &str, text: &str| md5sum(name, text).expect("definition");
    assert_eq!(sum("std_msgs/Empty", ""), "d41d8cd98f00b204e9800998ecf8427e");
    assert_eq!(sum("std_msgs/String", "string data\n"), "992ce8a1687cec8c8bd883ec73ca41d1");
    assert_eq!(
        sum("std_msgs/Header", "uint32 seq # n\ntime stamp\n\nstring frame_id"),
        "2176decaecbce78abc3b96ef049fabed"
    );
    let log = with(
        "byte DEBUG=1 #debug level\nbyte INFO=2  #general level\nbyte WARN=4  #warning level\n\
         byte ERROR=8 #error level\nbyte FATAL=16 #fatal/critical level\n## Fields\nHeader header\nbyte level\n\
         string name # name of the node\nstring msg # message \nstring file\nstring function\nuint32 line\nstring[] topics",
        &[("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id")],
    );
    assert_eq!(sum("rosgraph_msgs/Log", &log), "acffd30cd6b6de30f120938c17c593fb");
}

#[test]
fn a_header_under_its_old_name_is_a_header() {
    let text = with("Header header\nuint8 x", &[("roslib/Header", "uint32 seq\ntime stamp\nstring frame_id")]);
    let definition = parse(&text).expect("as bags of 2010 carry it");
    assert!(definition.begins_with_header());
    let body = [7, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0, b'f', 9];
    let value = definition.decode(&body, Limits::default()).expect("fits").to_json();
    assert_eq!(
        (&value["header"]["seq"], &value["header"]["frame_id"], &value["x"]),
        (&7.into(), &"f".into(), &9.into())
    );
}

#[test]
fn headers_are_seen_where_they_are_first() {
    let header = ("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id");
    assert!(parse(&with("# c\nuint8 K=1\nHeader header", &[header])).expect("definition").begins_with_header());
    assert!(!parse(&with("uint8 x\nHeader header", &[header])).expect("definition").begins_with_header());
    assert!(!parse(&with("Header[] headers", &[header])).expect("definition").begins_with_header());
    assert!(!parse("").expect("definition").begins_with_header());
}

proptest! {
    #[test]
    fn bodies_of_noise_never_panic(body in prop::collection::vec(any::<u8>(), 0..1200), elements in 0usize..64) {
        let limits = Limits { elements, steps: 5000 };
        for (name, text) in [(ODOMETRY, odometry_definition()), (COMPRESSED_IMAGE, compressed_image_definition())] {
            let definition = Definition::parse(name, &text).expect("definition");
            if let Ok(value) = definition.decode(&body, limits) {
                prop_assert!(!value.flatten(usize::MAX).is_empty());
            }
            definition.compressed_image(&body);
        }
    }

    #[test]
    fn definitions_of_noise_never_panic(
        text in "((u?int8|string|float64|Header|T[1-3]|a/T1|time)(\\[[0-9]{0,9}\\])? [a-z]{1,3}(=[0-9]{1,3})?( #x)?\n|={80}\nMSG: (a/T[1-3]|std_msgs/Header)\n|.){0,30}",
        body in prop::collection::vec(any::<u8>(), 0..100),
    ) {
        if let Ok(definition) = Definition::parse("a/T1", &text) {
            prop_assert_eq!(definition.md5sum().len(), 32);
            if let Ok(value) = definition.decode(&body, Limits { elements: 16, steps: 5000 }) {
                serde_json::to_string(&value).expect("json");
            }
        }
    }

    #[test]
    fn numbers_are_the_same_after_an_answer_is_parsed(
        wide in prop::collection::vec(any::<f64>(), 1..20),
        narrow in any::<f32>(),
        most in any::<u64>(),
        least in any::<i64>(),
    ) {
        let wide: Vec<f64> = wide.into_iter().filter(|number| number.is_finite()).collect();
        let narrow = if narrow.is_finite() { narrow } else { 0.1 };
        let mut body = u32::try_from(wide.len()).expect("few").to_le_bytes().to_vec();
        wide.iter().for_each(|number| body.extend(number.to_le_bytes()));
        body.extend(narrow.to_le_bytes());
        body.extend(most.to_le_bytes());
        body.extend(least.to_le_bytes());
        let shown = decode("float64[] wide\nfloat32 narrow\nuint64 most\nint64 least", &body).expect("decoded").to_json();
        // As between a site and who asks it: printed, parsed, printed and parsed by the reader.
        let mut answer = shown.to_string();
        for _ in 0..2 {
            answer = serde_json::from_str::<serde_json::Value>(&answer).expect("JSON").to_string();
        }
        let read: serde_json::Value = serde_json::from_str(&answer).expect("JSON");
        let bits = |value: &serde_json::Value| value.as_f64().map(f64::to_bits);
        for (place, number) in wide.iter().enumerate() {
            prop_assert_eq!(bits(&read["wide"][place]), Some(number.to_bits()));
        }
        prop_assert_eq!(bits(&read["narrow"]), Some(f64::from(narrow).to_bits()));
        prop_assert_eq!((read["most"].as_u64(), read["least"].as_i64()), (Some(most), Some(least)));
    }
}
