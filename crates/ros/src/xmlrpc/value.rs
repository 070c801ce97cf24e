//! XML-RPC values as XML: only the subset of XML it needs (no document types, no custom entities), nested at most 16
//! deep. The caller caps the input's size.

use std::borrow::Cow;

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, escape::partial_escape};

/// Dates and base64 remain text, unchanged.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Int(i64),
    Bool(bool),
    Double(f64),
    Text(String),
    Array(Vec<Value>),
    Struct(Vec<(String, Value)>),
    Nil,
}

impl Value {
    pub fn as_array(&self) -> Option<&[Value]> {
        if let Self::Array(items) = self { Some(items) } else { None }
    }

    pub fn as_text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    pub fn as_int(&self) -> Option<i64> {
        if let Self::Int(number) = self { Some(*number) } else { None }
    }

    /// Elements that are not texts are left out.
    pub fn texts(&self) -> Vec<String> {
        self.as_array().unwrap_or_default().iter().filter_map(Self::as_text).map(str::to_owned).collect()
    }

    fn write(&self, out: &mut String) {
        out.push_str("<value>");
        match self {
            Self::Int(number) if i32::try_from(*number).is_ok() => scalar("int", &number.to_string(), out),
            Self::Int(number) => scalar("i8", &number.to_string(), out),
            Self::Bool(flag) => scalar("boolean", if *flag { "1" } else { "0" }, out),
            Self::Double(number) => scalar("double", &number.to_string(), out),
            Self::Text(text) => scalar("string", &escaped(text), out),
            Self::Array(items) => {
                out.push_str("<array><data>");
                for item in items {
                    item.write(out);
                }
                out.push_str("</data></array>");
            }
            Self::Struct(members) => {
                out.push_str("<struct>");
                for (name, value) in members {
                    out.push_str("<member>");
                    scalar("name", &escaped(name), out);
                    value.write(out);
                    out.push_str("</member>");
                }
                out.push_str("</struct>");
            }
            Self::Nil => out.push_str("<nil/>"),
        }
        out.push_str("</value>");
    }
}

impl<T: Into<Value>> FromIterator<T> for Value {
    fn from_iter<I: IntoIterator<Item = T>>(items: I) -> Self {
        Self::Array(items.into_iter().map(Into::into).collect())
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

fn scalar(tag: &str, text: &str, out: &mut String) {
    for part in ["<", tag, ">", text, "</", tag, ">"] {
        out.push_str(part);
    }
}

/// A reader of XML may take a carriage return for a line feed.
fn escaped(text: &str) -> String {
    partial_escape(text).replace('\r', "&#13;")
}

pub(super) fn write_call(method: &str, params: &[Value]) -> String {
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodCall>");
    scalar("methodName", &escaped(method), &mut out);
    out.push_str("<params>");
    for param in params {
        out.push_str("<param>");
        param.write(&mut out);
        out.push_str("</param>");
    }
    out.push_str("</params></methodCall>");
    out
}

pub(super) fn write_response(value: &Value) -> String {
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodResponse><params><param>");
    value.write(&mut out);
    out.push_str("</param></params></methodResponse>");
    out
}

pub(super) fn write_fault(code: i64, reason: &str) -> String {
    let members = vec![("faultCode".to_owned(), Value::Int(code)), ("faultString".to_owned(), reason.into())];
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodResponse><fault>");
    Value::Struct(members).write(&mut out);
    out.push_str("</fault></methodResponse>");
    out
}

const DEEPEST: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not XML-RPC: {0}")]
pub(super) struct ParseError(&'static str);

type Result<T> = std::result::Result<T, ParseError>;

/// Reads tag by tag; each opened tag must be closed in order.
struct Tags<'a>(Reader<&'a [u8]>);

impl<'a> Tags<'a> {
    fn of(text: &'a str) -> Self {
        let mut reader = Reader::from_str(text);
        reader.config_mut().expand_empty_elements = true;
        Self(reader)
    }

    fn next(&mut self) -> Result<Event<'a>> {
        loop {
            match self.0.read_event() {
                Ok(Event::Decl(_) | Event::PI(_) | Event::Comment(_)) => {}
                Ok(Event::DocType(_)) => return Err(ParseError("it declares a document type")),
                Ok(Event::Eof) => return Err(ParseError("it ends too early")),
                Ok(event) => return Ok(event),
                Err(_) => return Err(ParseError("a tag is broken, or closed in the wrong place")),
            }
        }
    }

    /// `None` if the surrounding tag is closed.
    fn tag(&mut self) -> Result<Option<BytesStart<'a>>> {
        loop {
            match self.next()? {
                Event::Start(tag) => return Ok(Some(tag)),
                Event::End(_) => return Ok(None),
                Event::Text(text) if text.iter().all(u8::is_ascii_whitespace) => {}
                _ => return Err(ParseError("a text stands between tags")),
            }
        }
    }

    fn open(&mut self, name: &str) -> Result<()> {
        let is_it = self.tag()?.is_some_and(|tag| tag.name().as_ref() == name.as_bytes());
        if is_it { Ok(()) } else { Err(ParseError("another tag was expected")) }
    }

    fn close(&mut self) -> Result<()> {
        if self.tag()?.is_none() { Ok(()) } else { Err(ParseError("a tag holds more than it should")) }
    }

    /// Takes each tag of this name until the surrounding tag is closed.
    fn each(&mut self, name: &str, mut take: impl FnMut(&mut Self) -> Result<()>) -> Result<()> {
        while let Some(tag) = self.tag()? {
            if tag.name().as_ref() != name.as_bytes() {
                return Err(ParseError("another tag was expected"));
            }
            take(self)?;
        }
        Ok(())
    }

    /// Consumes the closing tag too.
    fn text(&mut self) -> Result<String> {
        let mut out = String::new();
        loop {
            match self.next()? {
                Event::End(_) => return Ok(out),
                event => out.push_str(&text_of(&event)?),
            }
        }
    }
}

fn text_of<'a>(event: &'a Event<'_>) -> Result<Cow<'a, str>> {
    match event {
        Event::Text(text) => unescaped(&String::from_utf8_lossy(text)).map(Cow::Owned),
        Event::CData(text) => Ok(String::from_utf8_lossy(text)),
        _ => Err(ParseError("a text holds tags")),
    }
}

/// Nodes write any character by its number, also those that XML lacks, for which the library refuses the text.
fn unescaped(mut text: &str) -> Result<String> {
    let mut out = String::new();
    while let Some((plain, after)) = text.split_once('&') {
        let (entity, rest) = after.split_once(';').ok_or(ParseError("an entity does not end"))?;
        let character = match entity {
            "amp" => Some('&'),
            "lt" => Some('<'),
            "gt" => Some('>'),
            "quot" => Some('"'),
            "apos" => Some('\''),
            _ => numeric(entity),
        };
        out.push_str(plain);
        out.push(character.ok_or(ParseError("an entity is unknown"))?);
        text = rest;
    }
    Ok(out + text)
}

fn numeric(entity: &str) -> Option<char> {
    let digits = entity.strip_prefix('#')?;
    let code = match digits.strip_prefix(['x', 'X']) {
        Some(hex) => u32::from_str_radix(hex, 16).ok()?,
        None => digits.parse().ok()?,
    };
    char::from_u32(code)
}

/// After an opened `<value>`; consumes the closing tag.
fn value(tags: &mut Tags<'_>, depth: usize) -> Result<Value> {
    if depth > DEEPEST {
        return Err(ParseError("its values are nested too deeply"));
    }
    let mut plain = String::new();
    loop {
        match tags.next()? {
            Event::End(_) => return Ok(Value::Text(plain)),
            Event::Start(tag) => {
                let inner = typed(tags, &String::from_utf8_lossy(tag.name().as_ref()), depth)?;
                tags.close()?;
                return Ok(inner);
            }
            event => plain.push_str(&text_of(&event)?),
        }
    }
}

fn typed(tags: &mut Tags<'_>, kind: &str, depth: usize) -> Result<Value> {
    match kind {
        "array" => {
            let mut items = Vec::new();
            tags.open("data")?;
            tags.each("value", |tags| {
                items.push(value(tags, depth + 1)?);
                Ok(())
            })?;
            tags.close()?;
            Ok(Value::Array(items))
        }
        "struct" => {
            let mut members = Vec::new();
            tags.each("member", |tags| {
                tags.open("name")?;
                let name = tags.text()?;
                tags.open("value")?;
                members.push((name, value(tags, depth + 1)?));
                tags.close()
            })?;
            Ok(Value::Struct(members))
        }
        "string" => tags.text().map(Value::Text),
        "dateTime.iso8601" | "base64" => Ok(Value::Text(tags.text()?.trim().to_owned())),
        "nil" => tags.text().map(|_| Value::Nil),
        _ => number(kind, tags.text()?.trim()).ok_or(ParseError("a value does not match its type")),
    }
}

fn number(kind: &str, text: &str) -> Option<Value> {
    match (kind, text) {
        ("int" | "i4" | "i8", _) => text.parse().ok().map(Value::Int),
        ("double", _) => text.parse().ok().map(Value::Double),
        ("boolean", "0" | "false") => Some(Value::Bool(false)),
        ("boolean", "1" | "true") => Some(Value::Bool(true)),
        _ => None,
    }
}

/// Method name and parameters.
pub(super) fn parse_call(text: &str) -> Result<(String, Vec<Value>)> {
    let mut tags = Tags::of(text);
    tags.open("methodCall")?;
    tags.open("methodName")?;
    let (method, mut params) = (tags.text()?.trim().to_owned(), Vec::new());
    match tags.tag()? {
        Some(tag) if tag.name().as_ref() == b"params" => tags.each("param", |tags| {
            tags.open("value")?;
            params.push(value(tags, 0)?);
            tags.close()
        })?,
        Some(_) => return Err(ParseError("a call has no parameters")),
        None => {}
    }
    Ok((method, params))
}

/// The one value, or the text of the fault.
pub(super) fn parse_response(text: &str) -> Result<std::result::Result<Value, String>> {
    let mut tags = Tags::of(text);
    tags.open("methodResponse")?;
    match tags.tag()? {
        Some(tag) if tag.name().as_ref() == b"params" => {
            tags.open("param")?;
            tags.open("value")?;
            value(&mut tags, 0).map(Ok)
        }
        Some(tag) if tag.name().as_ref() == b"fault" => {
            tags.open("value")?;
            Ok(Err(fault_words(&value(&mut tags, 0)?)))
        }
        _ => Err(ParseError("a response has neither value nor fault")),
    }
}

fn fault_words(fault: &Value) -> String {
    let Value::Struct(members) = fault else { return String::from("a fault without a description") };
    let words = members.iter().find(|(name, _)| name == "faultString").and_then(|(_, value)| value.as_text());
    words.unwrap_or("a fault without a description").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use super::{write_call, write_fault, write_response};
    use proptest::prelude::*;

    fn any_value() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            any::<i64>().prop_map(Value::Int),
            any::<bool>().prop_map(Value::Bool),
            any::<i32>().prop_map(|n| Value::Double(f64::from(n) / 8.0)),
            any::<String>().prop_map(Value::Text),
            Just(Value::Nil),
        ];
        leaf.prop_recursive(4, 40, 6, |inner| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..6).prop_map(Value::Array),
                prop::collection::vec((any::<String>(), inner), 0..4).prop_map(Value::Struct),
            ]
        })
    }

    #[test]
    fn a_character_named_by_its_number_is_read_also_where_xml_has_none() {
        let answer = |text: &str| {
            let text =
                format!("<methodResponse><params><param><value>{text}</value></param></params></methodResponse>");
            parse_response(&text)
        };
        for (text, expected) in [("&#0;&#27;&#x1B;&amp;", "\0\u{1b}\u{1b}&"), ("a&#9731;b&lt;", "a\u{2603}b<")] {
            assert_eq!(answer(text), Ok(Ok(Value::Text(expected.to_owned()))), "{text}");
        }
        for wrong in ["&nbsp;", "&#xD800;", "&#;", "&amp", "&#1114112;"] {
            assert!(answer(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_real_peers_send() {
        let text = "<?xml version='1.0'?>\n<methodResponse>\n<params>\n<param>\n<value><array><data>\n\
            <value><int>1</int></value>\n<value>plain</value><value><string/></value><value/>\n\
            <value><array><data>\n</data></array></value></data></array></value>\n</param></params>\n</methodResponse>";
        let expected =
            vec![Value::Int(1), Value::from("plain"), Value::from(""), Value::from(""), Value::Array(Vec::new())];
        assert_eq!(parse_response(text), Ok(Ok(Value::Array(expected))));
        let call = "<methodCall><methodName>getPid</methodName></methodCall>";
        assert_eq!(parse_call(call), Ok(("getPid".into(), Vec::new())));
        assert_eq!(parse_response(&write_fault(-1, "no <such> thing")), Ok(Err("no <such> thing".into())));
    }

    #[test]
    fn hostile_texts_are_refused() {
        let deep = format!("<methodResponse><params><param>{}", "<value><array><data>".repeat(100_000));
        assert_eq!(parse_response(&deep), Err(ParseError("its values are nested too deeply")));
        for bad in [
            "",
            "<",
            "<!DOCTYPE x [<!ENTITY a 'b'>]><methodResponse>",
            "<methodResponse><params><param><value>&a;</value></param></params></methodResponse>",
            "<methodResponse><params><param><value><int>x</int></value></param></params></methodResponse>",
            "<methodResponse><params><param><value><frob>1</frob></value></param></params></methodResponse>",
            "<methodCall></methodCall>",
        ] {
            assert!(parse_response(bad).is_err(), "{bad}");
        }
    }

    proptest! {
        #[test]
        fn values_round_trip(value in any_value()) {
            prop_assert_eq!(parse_response(&write_response(&value)), Ok(Ok(value.clone())));
            let call = write_call("m", std::slice::from_ref(&value));
            prop_assert_eq!(parse_call(&call), Ok(("m".to_owned(), vec![value])));
        }

        #[test]
        fn cut_calls_are_refused(value in any_value(), part in any::<prop::sample::Index>()) {
            let whole = write_call("m", &[value]);
            let end = whole.len() - "</params></methodCall>".len();
            let cut = whole.floor_char_boundary(part.index(end));
            prop_assert!(parse_call(&whole[..cut]).is_err());
        }

        #[test]
        fn noise_never_panics(text in "(<[/!?]?(value|array|data|int|struct|member|name|methodCall)/?>|&[a-z#0-9]*;?|.){0,60}") {
            let _ = parse_call(&text);
            let _ = parse_response(&format!("<methodResponse><params><param><value>{text}"));
        }
    }
}
