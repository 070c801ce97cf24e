//! Hostile ROS 2 definitions and bodies.

use proptest::prelude::*;

use super::*;
use crate::ros::message::{DEEPEST, LONGEST_DEFINITION, Limits};

const RULE: &str = "====================";

fn parse(text: &str) -> Result<Definition> {
    Definition::parse_ros2("a/msg/Root", text)
}

/// Types T1 .. Tn, each containing the next.
fn chain(length: usize) -> String {
    let section = |level: usize| {
        let below = if level == length { "uint8 end".to_owned() } else { format!("T{} below", level + 1) };
        format!("\n{RULE}\nMSG: a/T{level}\n{below}")
    };
    format!("T1 first{}", (1..=length).map(section).collect::<String>())
}

#[test]
fn definitions_without_end() {
    let circle = format!("B b\n{RULE}\nMSG: a/B\nC[] c\n{RULE}\nMSG: a/C\nB[<=3] b");
    assert!(parse(&circle).expect_err("a circle").to_string().contains("contains itself"));
    assert!(parse("Root r").is_err());
    assert!(parse(&chain(DEEPEST - 1)).is_ok());
    assert!(parse(&chain(DEEPEST)).expect_err("too deep").to_string().contains("deep"));
    assert!(parse(&"#".repeat(LONGEST_DEFINITION + 1)).is_err());
    assert!(parse("Missing m").expect_err("missing").to_string().contains("a/msg/Missing is missing"));
    let many: String = (0..600).map(|number| format!("\n{RULE}\nMSG: a/T{number}\nuint8 x")).collect();
    assert!(parse(&many).is_err());
    for name in ["no type", "a", "a/b/c", "a/msg/T/x", "/T"] {
        assert!(Definition::parse_ros2(name, "uint8 x").is_err(), "{name}");
    }
}

#[test]
fn counts_without_bytes() {
    let text = |field: &str| format!("{field}\n{RULE}\nMSG: a/E\n\n{RULE}\nMSG: a/F\nuint8[4000000000] x");
    for field in ["uint8[] x", "float64[] x", "string[] x", "string x", "wstring x", "wstring[] x", "E[] x", "F[] x"] {
        let definition = parse(&text(field)).expect("a definition");
        for kind in [0, 1, 6, 7, 8, 9] {
            for claim in [u32::MAX, 0x7fff_ffff, 1000] {
                let claims = [&claim.to_le_bytes(), &claim.to_be_bytes()].map(|claim| claim.repeat(3)).concat();
                let body = [&[0, kind, 0, 0][..], &claims].concat();
                assert!(definition.decode(&body, Limits::default()).is_err(), "{field} {kind} {claim}");
                assert!(definition.write_json(&body, &mut std::io::sink()).is_err(), "{field} {kind} {claim}");
            }
        }
    }
}

#[test]
fn headers_that_are_none() {
    let definition = parse("uint8 x").expect("a definition");
    let fails = |body: &[u8]| definition.decode(body, Limits::default()).expect_err("no CDR").to_string();
    for body in [&[][..], &[0, 1], &[0, 1, 0], &[1, 1, 0, 0, 5], &[0, 4, 0, 0, 5], &[0, 200, 0, 0, 5]] {
        assert!(fails(body).contains("like CDR"), "{body:?}");
    }
    for kind in [2, 3, 10, 11] {
        assert!(fails(&[0, kind, 0, 0, 5]).contains("PL_CDR"));
    }
    assert!(fails(&[0, 1, 0, 0]).contains("ends before"));
}

#[test]
fn truncated_at_every_byte() {
    let text = format!("string a\nP[] parts\nfloat64[2] xs\n{RULE}\nMSG: a/P\nuint8 k\nint64 n\nstring s");
    let definition = parse(&text).expect("a definition");
    let text = [3, 0, 0, 0, b'h', b'i', 0, 0];
    let (count, number, name) = ([1, 0, 0, 0], [4, 0, 0, 0], [2, 0, 0, 0, b'z', 0, 0, 0]);
    let body = [&[0, 1, 0, 0][..], &text, &count, &number, &[4; 8], &name, &[0; 16]].concat();
    let value = definition.decode(&body, Limits::default()).expect("fits");
    assert_eq!(value.to_json()["parts"][0]["s"], "z");
    for end in 0..body.len() {
        assert!(definition.decode(&body[..end], Limits::default()).is_err(), "{end}");
    }
}

proptest! {
    #[test]
    fn noise_never_panics(
        text in "(((u?int8|w?string|float64|byte|T[1-3]|a/msg/T1)(<=[0-9]{1,3})?(\\[(<=)?[0-9]{0,4}\\])?|int64) [a-z]{1,3}( ?=[0-9]{1,3})?( #x)?\n|={20}\nMSG: a/T[1-3]\n|.){0,30}",
        kind in prop::sample::select(vec![0u8, 1, 6, 7, 8, 9]),
        body in prop::collection::vec(prop_oneof![Just(0u8), Just(1), Just(2), any::<u8>()], 0..200),
    ) {
        if let Ok(definition) = Definition::parse_ros2("a/msg/T1", &text) {
            prop_assert_eq!(type_hash("a/msg/T1", &text).expect("parsed before").len(), 71);
            let body = [&[0, kind, 0, 0][..], &body].concat();
            let limits = Limits { elements: 16, steps: 5000 };
            let mut out = Vec::new();
            let written = definition.write_json(&body, &mut out).is_ok();
            if let Ok(value) = definition.decode(&body, limits) {
                serde_json::to_string(&value).expect("JSON");
                prop_assert!(written && out.len() < 100_000);
            }
            definition.matrix(&body);
        }
    }

    /// Whatever a hostile length claims, the value is no larger than the body allows.
    #[test]
    fn values_are_bounded_by_bytes(lengths in prop::collection::vec(any::<u32>(), 1..6), rest in 0usize..400) {
        let text = format!("P[] parts\nstring[] names\n{RULE}\nMSG: a/P\nuint8[] a\nE[] b\n{RULE}\nMSG: a/E\n");
        let definition = parse(&text).expect("a definition");
        let small = lengths.iter().map(|length| if length % 3 == 0 { *length } else { length % 40 });
        let body = [vec![0, 1, 0, 0], small.flat_map(u32::to_le_bytes).collect(), vec![0; rest]].concat();
        let limits = Limits { elements: usize::MAX, ..Limits::default() };
        if let Ok(value) = definition.decode(&body, limits) {
            prop_assert!(value.flatten(usize::MAX).len() <= body.len());
        }
    }
    /// Whatever a publisher calls its type, it is found whole or not at all.
    #[test]
    fn names_of_types_find_all_or_nothing(
        name in "((std|nav|sensor|a|\\.\\.)(_msgs)?/(msg|srv|\\.\\.)?/?(String|Header|Odometry|[A-Za-z.]{0,9})|.{0,20})",
    ) {
        let folders = Folders::default();
        match folders.text_of(&name) {
            Ok((text, _)) => prop_assert!(folders.may_know(&name) && Definition::parse_ros2(&name, &text).is_ok()),
            Err(_) => prop_assert!(!folders.may_know(&name)),
        }
    }
}
