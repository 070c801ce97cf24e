//! `type_description_interfaces/srv/GetTypeDescription` (REP 2016): the request, and what is taken from the answer.

use crate::cdr::{Reader, Writer};

/// The longest text that is passed on, bytes.
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
    /// The text of the type with all the types it consists of, as in MCAP's `ros2msg`.
    Text(String),
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
    skip_type(reader)?;
    for _ in 0..reader.count(TYPE)? {
        skip_type(reader)?;
    }
    let mut sources = Vec::new();
    for _ in 0..reader.count(SOURCE)? {
        sources.push((reader.text()?, reader.text()?, reader.text()?));
    }
    Some(joined(&sources, type_name))
}

/// The structured description: the hash is computed from the text anyway.
fn skip_type(reader: &mut Reader<'_>) -> Option<()> {
    reader.text()?;
    for _ in 0..reader.count(FIELD)? {
        reader.text()?;
        reader.byte()?;
        reader.long()?;
        reader.long()?;
        reader.text()?;
        reader.text()?;
    }
    Some(())
}

fn joined(sources: &[(&str, &str, &str)], type_name: &str) -> Answer {
    let Some((_, encoding, own)) = sources.iter().find(|(name, ..)| *name == type_name) else {
        return Answer::Refused("it answers without the text of the type".to_owned());
    };
    let others = sources.iter().filter(|(name, ..)| *name != type_name);
    if *encoding != "msg" || others.clone().any(|(_, encoding, _)| *encoding != "msg") {
        return Answer::Refused("it describes the type in another language than .msg".to_owned());
    }
    let mut text = format!("{}\n", own.trim_end());
    for (name, _, lines) in others {
        let short = name.replacen("/msg/", "/", 1);
        text.push_str(&format!("{}\nMSG: {short}\n{}\n", "=".repeat(80), lines.trim_end()));
    }
    if text.len() > LONGEST_TEXT {
        return Answer::Refused(format!("its text is longer than {LONGEST_TEXT} bytes"));
    }
    Answer::Text(text)
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
            assert_eq!(found, Some(Answer::Text(expected.clone())), "{header:?}");
        }
        assert_eq!(answer(&reply(Some((7, 9)), &[GRIP]), Some((7, 8)), GRIP.0), None, "another's");
    }

    #[test]
    fn what_helps_nobody_is_refused_with_a_reason() {
        let said = |sources: &[(&str, &str, &str)]| match answer(&reply(None, sources), None, GRIP.0) {
            Some(Answer::Refused(reason)) => reason,
            other => panic!("{other:?}"),
        };
        assert!(said(&[JAW]).contains("without the text"));
        assert!(said(&[GRIP, (JAW.0, "idl", "module x {};")]).contains("another language"));
        let long = "x".repeat(LONGEST_TEXT);
        assert!(said(&[(GRIP.0, "msg", &long)]).contains("longer"));
        let whole = reply(None, &[GRIP, JAW]);
        for end in 0..whole.len() - 8 {
            assert!(matches!(answer(&whole[..end], None, GRIP.0), Some(Answer::Refused(_))), "{end}");
        }
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
