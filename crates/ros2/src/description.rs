//! `type_description_interfaces/srv/GetTypeDescription` (REP 2016): the request, and what is taken from the answer.

use crate::cdr::{Reader, Writer};

/// The longest of the texts that are passed on, bytes.
pub const LONGEST_TEXT: usize = 1 << 20;
/// The least bytes of a field, of a type and of a source in an answer.
const FIELD: usize = 4;
const TYPE: usize = 4;
const SOURCE: usize = 4;

/// Two numbers that relate an answer to its request, where both are written before the body (`rmw_cyclonedds`).
pub type Header = (u64, u64);

/// The body of a request for the sources of a type.
pub fn request(header: Option<Header>, type_name: &str, type_hash: &str) -> Vec<u8> {
    let mut body = Writer::default();
    if let Some((client, number)) = header {
        body.long(client);
        body.long(number);
    }
    body.text(type_name);
    body.text(type_hash);
    body.truth(true);
    body.0
}

/// An answer.
#[derive(Debug, PartialEq, Eq)]
pub enum Answer {
    /// The type with all the types it consists of, as in MCAP's `ros2msg`, twice: the texts that its package was built from, empty
    /// if there are none in `.msg`, and what is written from its structure.
    Texts(String, String),
    /// There is none, and why.
    Refused(String),
}

/// Reads an answer with its header of encapsulation; `None` if it belongs to another request.
pub fn answer(message: &[u8], header: Option<Header>, type_name: &str) -> Option<Answer> {
    let unreadable = || Answer::Refused("its answer cannot be read".to_owned());
    let Some(mut reader) = Reader::of(message) else { return Some(unreadable()) };
    if let Some(own) = header {
        let theirs = reader.long().zip(reader.long());
        if theirs != Some(own) {
            return None;
        }
    }
    Some(read(&mut reader, type_name).unwrap_or_else(unreadable))
}

fn read(reader: &mut Reader<'_>, type_name: &str) -> Option<Answer> {
    let is_successful = reader.byte()? == 1;
    let reason = reader.text()?;
    if !is_successful {
        return Some(Answer::Refused(format!("it refuses: {reason}")));
    }
    let mut types = vec![structure(reader)?];
    for _ in 0..reader.count(TYPE)? {
        types.push(structure(reader)?);
    }
    // rclpy's texts may be cut in the middle of a character; the structure does not depend on them.
    let sources = sources(reader).unwrap_or_default();
    let (text, structure) = (joined(&sources, type_name), whole_structure(&types, type_name));
    if text.is_empty() && structure.is_empty() {
        return Some(Answer::Refused("what it answers cannot be said in .msg, or is too long".to_owned()));
    }
    Some(Answer::Texts(text, structure))
}

fn sources<'a>(reader: &mut Reader<'a>) -> Option<Vec<(&'a str, &'a str, &'a str)>> {
    (0..reader.count(SOURCE)?).map(|_| Some((reader.text()?, reader.text()?, reader.text()?))).collect()
}

/// One type of a structured description: its name, and its lines in `.msg`, if these can say it.
fn structure<'a>(reader: &mut Reader<'a>) -> Option<(&'a str, Option<String>)> {
    let name = reader.text()?;
    let mut lines = Some(String::new());
    for _ in 0..reader.count(FIELD)? {
        let (field, number, capacity) = (reader.text()?, reader.byte()?, reader.long()?);
        let (bound, nested, _default) = (reader.long()?, reader.text()?, reader.text()?);
        // A type without fields is described by this one.
        if field == "structure_needs_at_least_one_member" {
            continue;
        }
        let line = kind(number, capacity, bound, nested).map(|kind| format!("{kind} {field}\n"));
        lines = lines.zip(line).map(|(lines, line)| lines + &line);
    }
    Some((name, lines))
}

/// A field's type as `.msg` has it; `None` for one of IDL alone.
fn kind(number: u8, capacity: u64, bound: u64, nested: &str) -> Option<String> {
    const PLAIN: [&str; 10] =
        ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"];
    let element = match number % 48 {
        1 => short(nested),
        plain @ 2..=11 => PLAIN.get(usize::from(plain - 2)).map(|name| (*name).to_owned())?,
        15 => "bool".to_owned(),
        16 => "byte".to_owned(),
        17 => "string".to_owned(),
        18 => "wstring".to_owned(),
        21 => format!("string<={bound}"),
        22 => format!("wstring<={bound}"),
        _ => return None,
    };
    Some(match number / 48 {
        0 => element,
        1 => format!("{element}[{capacity}]"),
        2 => format!("{element}[<={capacity}]"),
        3 => format!("{element}[]"),
        _ => return None,
    })
}

fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

/// Empty if a part is missing or cannot be said, or all of it is too long.
fn whole_structure(types: &[(&str, Option<String>)], type_name: &str) -> String {
    let parts: Option<Vec<_>> = types.iter().map(|(name, lines)| Some((*name, lines.as_deref()?))).collect();
    let text = parts.map(|parts| whole(&parts, type_name)).unwrap_or_default();
    if text.is_empty() { text } else { format!("{WRITTEN}{text}") }
}

/// Begins a text that is written from a structure.
const WRITTEN: &str =
    "# From the structure that the publishing node told: without comments, constants and default values.\n";

/// Empty if there is none of the type itself, or one is not in `.msg`, or all of it is too long.
fn joined(sources: &[(&str, &str, &str)], type_name: &str) -> String {
    let parts = sources.iter().map(|(name, encoding, lines)| (*encoding == "msg").then_some((*name, *lines)));
    parts.collect::<Option<Vec<_>>>().map(|parts| whole(&parts, type_name)).unwrap_or_default()
}

fn whole(parts: &[(&str, &str)], type_name: &str) -> String {
    let Some((_, own)) = parts.iter().find(|(name, _)| *name == type_name) else { return String::new() };
    let mut text = format!("{}\n", own.trim_end());
    for (name, lines) in parts.iter().filter(|(name, _)| *name != type_name) {
        text.push_str(&format!("{}\nMSG: {}\n{}\n", "=".repeat(80), short(name), lines.trim_end()));
    }
    if text.len() > LONGEST_TEXT { String::new() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: one type of one field, one other type, and these sources.
    fn reply(header: Option<Header>, sources: &[(&str, &str, &str)]) -> Vec<u8> {
        let mut body = Writer::default();
        if let Some((client, number)) = header {
            body.long(client);
            body.long(number);
        }
        body.truth(true);
        body.text("");
        let put_number = |body: &mut Writer, number: u32| {
            body.0.resize(body.0.len().next_multiple_of(4), 0);
            body.0.extend(number.to_le_bytes());
        };
        let put_type = |body: &mut Writer, name: &str| {
            body.text(name);
            put_number(body, 1);
            body.text("force");
            body.0.push(11);
            body.long(0);
            body.long(0);
            body.text("");
            body.text("");
        };
        put_type(&mut body, "rig_msgs/msg/Grip");
        put_number(&mut body, 1);
        put_type(&mut body, "rig_msgs/msg/Jaw");
        put_number(&mut body, u32::try_from(sources.len()).expect("few"));
        for (name, encoding, text) in sources {
            body.text(name);
            body.text(encoding);
            body.text(text);
        }
        put_number(&mut body, 0);
        [vec![0, 1, 0, 0], body.0].concat()
    }

    const GRIP: (&str, &str, &str) = ("rig_msgs/msg/Grip", "msg", "Jaw left # the left one\n\n");
    const JAW: (&str, &str, &str) = ("rig_msgs/msg/Jaw", "msg", "float64 force\n");

    #[test]
    fn the_text_of_a_type_is_put_together_in_mcap_s_form() {
        let expected = format!("Jaw left # the left one\n{}\nMSG: rig_msgs/Jaw\nfloat64 force\n", "=".repeat(80));
        for header in [None, Some((7, 9))] {
            let found = answer(&reply(header, &[JAW, GRIP]), header, GRIP.0);
            assert_eq!(found, Some(Answer::Texts(expected.clone(), written())), "{header:?}");
        }
        assert_eq!(answer(&reply(Some((7, 9)), &[GRIP]), Some((7, 8)), GRIP.0), None, "another's");
    }

    fn written() -> String {
        format!("{WRITTEN}float64 force\n{}\nMSG: rig_msgs/Jaw\nfloat64 force\n", "=".repeat(80))
    }

    #[test]
    fn the_structure_is_told_where_the_texts_help_nobody() {
        let long = "x".repeat(LONGEST_TEXT);
        let cut = (JAW.0, "msg", "float64 force # 10\u{b0}");
        for sources in [&[JAW][..], &[], &[GRIP, (JAW.0, "idl", "module x {};")], &[(GRIP.0, "msg", &long)]] {
            let found = answer(&reply(None, sources), None, GRIP.0);
            assert_eq!(found, Some(Answer::Texts(String::new(), written())), "{sources:?}");
        }
        // A text that ends within a character.
        let mut spoilt = reply(None, &[GRIP, cut]);
        let place = spoilt.windows(2).position(|pair| pair == "\u{b0}".as_bytes()).expect("there");
        spoilt[place + 1] = b' ';
        assert_eq!(answer(&spoilt, None, GRIP.0), Some(Answer::Texts(String::new(), written())));
    }

    #[test]
    fn every_kind_of_field_is_written_as_in_msg_or_not_at_all() {
        let cases = [
            ((2, 0, 0, ""), Some("int8")),
            ((58, 36, 0, ""), Some("float32[36]")),
            ((11 + 96, 3, 0, ""), Some("float64[<=3]")),
            ((17 + 144, 0, 0, ""), Some("string[]")),
            ((22 + 96, 4, 3, ""), Some("wstring<=3[<=4]")),
            ((21, 0, 10, ""), Some("string<=10")),
            ((1 + 144, 0, 0, "a/msg/B"), Some("a/B[]")),
            ((1, 0, 0, "a/srv/B_Request"), Some("a/srv/B_Request")),
            ((15, 0, 0, ""), Some("bool")),
            ((16, 0, 0, ""), Some("byte")),
            // A long double, a char of IDL, a text of fixed length, and none.
            ((12, 0, 0, ""), None),
            ((13, 0, 0, ""), None),
            ((19, 0, 0, ""), None),
            ((0, 0, 0, ""), None),
            ((48 * 4 + 2, 0, 0, ""), None),
        ];
        for ((number, capacity, bound, nested), expected) in cases {
            assert_eq!(kind(number, capacity, bound, nested).as_deref(), expected, "{number}");
        }
    }

    #[test]
    fn what_helps_nobody_is_refused_with_a_reason() {
        let whole = reply(None, &[GRIP, JAW]);
        let second = whole.windows(JAW.0.len()).position(|part| part == JAW.0.as_bytes()).expect("there") + 40;
        for end in 0..second {
            assert!(matches!(answer(&whole[..end], None, GRIP.0), Some(Answer::Refused(_))), "{end}");
        }
        assert!(matches!(answer(&whole, None, "rig_msgs/msg/Other"), Some(Answer::Refused(_))), "of another type");
        // No byte makes it take what is not there.
        for place in 4..whole.len() {
            for byte in [0, 1, 0x7f, 0xff] {
                let mut spoilt = whole.clone();
                spoilt[place] = byte;
                assert!(answer(&spoilt, None, GRIP.0).is_some(), "{place} {byte}");
            }
        }
        let mut refusal = Writer::default();
        refusal.truth(false);
        refusal.text("not mine");
        let refusal = [vec![0, 1, 0, 0], refusal.0].concat();
        assert_eq!(answer(&refusal, None, GRIP.0), Some(Answer::Refused("it refuses: not mine".into())));
    }

    #[test]
    fn a_request_is_aligned_and_begins_with_its_numbers_where_they_are_wanted() {
        let plain = request(None, "a/msg/B", "RIHS01_0");
        let expected = [8, 0, 0, 0]
            .into_iter()
            .chain(*b"a/msg/B\0")
            .chain([9, 0, 0, 0])
            .chain(*b"RIHS01_0\0")
            .chain([1])
            .collect::<Vec<u8>>();
        assert_eq!(plain, expected);
        let related = request(Some((2, 3)), "a/msg/B", "RIHS01_0");
        assert_eq!(related[..16], [2, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(related[16..], expected);
    }
}
