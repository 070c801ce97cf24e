//! XML-RPC values, written and parsed as XML: the subset of XML it uses, nothing else (no document types, no custom
//! entities), values nested at most 16 deep. The caller caps the input's size.

/// An XML-RPC value. Dates and base64 remain text, unchanged.
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
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// The elements of an array.
    pub fn as_array(&self) -> Option<&[Value]> {
        if let Self::Array(items) = self { Some(items) } else { None }
    }

    pub fn as_text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    /// The whole number.
    pub fn as_int(&self) -> Option<i64> {
        if let Self::Int(number) = self { Some(*number) } else { None }
    }

    /// The texts of an array of texts; others are left out.
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
            Self::Text(text) => {
                out.push_str("<string>");
                escape(text, out);
                out.push_str("</string>");
            }
            Self::Array(items) => {
                out.push_str("<array><data>");
                for item in items {
                    item.write(out);
                }
                out.push_str("</data></array>");
            }
            Self::Struct(members) => write_struct(members, out),
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

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::text(text)
    }
}

fn scalar(tag: &str, text: &str, out: &mut String) {
    for part in ["<", tag, ">", text, "</", tag, ">"] {
        out.push_str(part);
    }
}

fn write_struct(members: &[(String, Value)], out: &mut String) {
    out.push_str("<struct>");
    for (name, value) in members {
        out.push_str("<member><name>");
        escape(name, out);
        out.push_str("</name>");
        value.write(out);
        out.push_str("</member>");
    }
    out.push_str("</struct>");
}

fn escape(text: &str, out: &mut String) {
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\r' => out.push_str("&#13;"),
            _ => out.push(character),
        }
    }
}

/// The XML of a call.
pub(super) fn write_call(method: &str, params: &[Value]) -> String {
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodCall><methodName>");
    escape(method, &mut out);
    out.push_str("</methodName><params>");
    for param in params {
        out.push_str("<param>");
        param.write(&mut out);
        out.push_str("</param>");
    }
    out.push_str("</params></methodCall>");
    out
}

/// The XML of a result.
pub(super) fn write_response(value: &Value) -> String {
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodResponse><params><param>");
    value.write(&mut out);
    out.push_str("</param></params></methodResponse>");
    out
}

/// The XML of a fault.
pub(super) fn write_fault(code: i64, reason: &str) -> String {
    let members = vec![("faultCode".to_owned(), Value::Int(code)), ("faultString".to_owned(), Value::text(reason))];
    let mut out = String::from("<?xml version=\"1.0\"?>\n<methodResponse><fault>");
    Value::Struct(members).write(&mut out);
    out.push_str("</fault></methodResponse>");
    out
}

/// The deepest nesting of values accepted.
const DEEPEST: usize = 16;

/// Why a text is not XML-RPC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not XML-RPC: {0}")]
pub(super) struct ParseError(&'static str);

type Result<T> = std::result::Result<T, ParseError>;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Token<'a> {
    Open(&'a str),
    Close(&'a str),
    Empty(&'a str),
    Text(&'a str),
    Verbatim(&'a str),
}

/// The content of a response.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Response {
    Value(Value),
    Fault(String),
}

struct Tokens<'a> {
    rest: &'a str,
}

impl<'a> Tokens<'a> {
    fn next(&mut self) -> Result<Token<'a>> {
        loop {
            if let Some(after) = self.rest.strip_prefix("<?") {
                self.rest = after.split_once("?>").ok_or(ParseError("an instruction does not end"))?.1;
            } else if let Some(after) = self.rest.strip_prefix("<!--") {
                self.rest = after.split_once("-->").ok_or(ParseError("a comment does not end"))?.1;
            } else {
                return self.token();
            }
        }
    }

    fn token(&mut self) -> Result<Token<'a>> {
        if let Some(after) = self.rest.strip_prefix("<![CDATA[") {
            let (text, rest) = after.split_once("]]>").ok_or(ParseError("a text does not end"))?;
            self.rest = rest;
            return Ok(Token::Verbatim(text));
        }
        let Some(after) = self.rest.strip_prefix('<') else {
            let end = self.rest.find('<').ok_or(ParseError("it ends too early"))?;
            let (text, rest) = self.rest.split_at(end);
            self.rest = rest;
            return Ok(Token::Text(text));
        };
        let (tag, rest) = after.split_once('>').ok_or(ParseError("a tag does not end"))?;
        self.rest = rest;
        if let Some(name) = tag.strip_prefix('/') {
            Ok(Token::Close(name.trim()))
        } else if tag.starts_with('!') {
            Err(ParseError("it declares a document type"))
        } else if let Some(name) = tag.strip_suffix('/') {
            Ok(Token::Empty(name.trim()))
        } else {
            Ok(Token::Open(tag.split_whitespace().next().unwrap_or_default()))
        }
    }

    /// The next token that is not white space between tags.
    fn tag(&mut self) -> Result<Token<'a>> {
        loop {
            match self.next()? {
                Token::Text(text) if text.trim().is_empty() => {}
                token => return Ok(token),
            }
        }
    }

    fn open(&mut self, name: &'static str) -> Result<()> {
        if self.tag()? == Token::Open(name) { Ok(()) } else { Err(ParseError("another tag was expected")) }
    }

    fn close(&mut self, name: &str) -> Result<()> {
        if self.tag()? == Token::Close(name) { Ok(()) } else { Err(ParseError("a tag is not closed in its place")) }
    }

    /// Text up to the closing tag `name`, which is consumed too.
    fn text_until(&mut self, name: &str) -> Result<String> {
        let mut out = String::new();
        loop {
            match self.next()? {
                Token::Text(text) => unescape(text, &mut out)?,
                Token::Verbatim(text) => out.push_str(text),
                Token::Close(closed) if closed == name => return Ok(out),
                _ => return Err(ParseError("a text holds tags")),
            }
        }
    }
}

fn unescape(text: &str, out: &mut String) -> Result<()> {
    let mut rest = text;
    while let Some((plain, after)) = rest.split_once('&') {
        out.push_str(plain);
        let (entity, after) = after.split_once(';').ok_or(ParseError("an entity does not end"))?;
        out.push(match entity {
            "amp" => '&',
            "lt" => '<',
            "gt" => '>',
            "quot" => '"',
            "apos" => '\'',
            _ => numeric(entity).ok_or(ParseError("an entity is unknown"))?,
        });
        rest = after;
    }
    out.push_str(rest);
    Ok(())
}

fn numeric(entity: &str) -> Option<char> {
    let digits = entity.strip_prefix('#')?;
    let code = match digits.strip_prefix(['x', 'X']) {
        Some(hex) => u32::from_str_radix(hex, 16).ok()?,
        None => digits.parse().ok()?,
    };
    char::from_u32(code)
}

/// The value after an opened `<value>`, including the closing tag.
fn value(tokens: &mut Tokens<'_>, depth: usize) -> Result<Value> {
    if depth > DEEPEST {
        return Err(ParseError("its values are nested too deeply"));
    }
    let mut plain = String::new();
    loop {
        match tokens.next()? {
            Token::Text(text) => unescape(text, &mut plain)?,
            Token::Verbatim(text) => plain.push_str(text),
            Token::Close("value") => return Ok(Value::Text(plain)),
            Token::Open(kind) => {
                let inner = typed(tokens, kind, depth)?;
                tokens.close("value")?;
                return Ok(inner);
            }
            Token::Empty(kind) => {
                let inner = empty(kind)?;
                tokens.close("value")?;
                return Ok(inner);
            }
            Token::Close(_) => return Err(ParseError("a value is not closed in its place")),
        }
    }
}

fn empty(kind: &str) -> Result<Value> {
    match kind {
        "string" | "base64" => Ok(Value::Text(String::new())),
        "nil" => Ok(Value::Nil),
        "struct" => Ok(Value::Struct(Vec::new())),
        _ => Err(ParseError("a value is empty")),
    }
}

fn typed(tokens: &mut Tokens<'_>, kind: &str, depth: usize) -> Result<Value> {
    match kind {
        "array" => array(tokens, depth),
        "struct" => structure(tokens, depth),
        "string" => tokens.text_until(kind).map(Value::Text),
        "dateTime.iso8601" | "base64" => Ok(Value::Text(tokens.text_until(kind)?.trim().to_owned())),
        "nil" => tokens.text_until(kind).map(|_| Value::Nil),
        _ => number(kind, tokens.text_until(kind)?.trim()).ok_or(ParseError("a value does not match its type")),
    }
}

fn number(kind: &str, text: &str) -> Option<Value> {
    match kind {
        "int" | "i4" | "i8" => text.parse().ok().map(Value::Int),
        "double" => text.parse().ok().map(Value::Double),
        "boolean" => match text {
            "0" | "false" => Some(Value::Bool(false)),
            "1" | "true" => Some(Value::Bool(true)),
            _ => None,
        },
        _ => None,
    }
}

fn array(tokens: &mut Tokens<'_>, depth: usize) -> Result<Value> {
    let mut items = Vec::new();
    match tokens.tag()? {
        Token::Open("data") => loop {
            match tokens.tag()? {
                Token::Open("value") => items.push(value(tokens, depth + 1)?),
                Token::Empty("value") => items.push(Value::Text(String::new())),
                Token::Close("data") => break,
                _ => return Err(ParseError("an array contains something that is not a value")),
            }
        },
        Token::Empty("data") => {}
        _ => return Err(ParseError("an array has no data")),
    }
    tokens.close("array")?;
    Ok(Value::Array(items))
}

fn structure(tokens: &mut Tokens<'_>, depth: usize) -> Result<Value> {
    let mut members = Vec::new();
    loop {
        match tokens.tag()? {
            Token::Open("member") => {
                tokens.open("name")?;
                let name = tokens.text_until("name")?;
                tokens.open("value")?;
                members.push((name, value(tokens, depth + 1)?));
                tokens.close("member")?;
            }
            Token::Close("struct") => return Ok(Value::Struct(members)),
            _ => return Err(ParseError("a struct contains something that is not a member")),
        }
    }
}

/// Parses a call: method name and parameters.
pub(super) fn parse_call(text: &str) -> Result<(String, Vec<Value>)> {
    let mut tokens = Tokens { rest: text };
    tokens.open("methodCall")?;
    tokens.open("methodName")?;
    let method = tokens.text_until("methodName")?.trim().to_owned();
    let mut params = Vec::new();
    match tokens.tag()? {
        Token::Open("params") => {}
        Token::Empty("params") | Token::Close("methodCall") => return Ok((method, params)),
        _ => return Err(ParseError("a call has no parameters")),
    }
    loop {
        match tokens.tag()? {
            Token::Open("param") => {
                tokens.open("value")?;
                params.push(value(&mut tokens, 0)?);
                tokens.close("param")?;
            }
            Token::Close("params") => return Ok((method, params)),
            _ => return Err(ParseError("a call has broken parameters")),
        }
    }
}

/// Parses a response: its one value, or the text of its fault.
pub(super) fn parse_response(text: &str) -> Result<Response> {
    let mut tokens = Tokens { rest: text };
    tokens.open("methodResponse")?;
    match tokens.tag()? {
        Token::Open("params") => {
            tokens.open("param")?;
            tokens.open("value")?;
            value(&mut tokens, 0).map(Response::Value)
        }
        Token::Open("fault") => {
            tokens.open("value")?;
            Ok(Response::Fault(fault_words(&value(&mut tokens, 0)?)))
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
    fn what_real_peers_send() {
        let text = "<?xml version='1.0'?>\n<methodResponse>\n<params>\n<param>\n<value><array><data>\n\
            <value><int>1</int></value>\n<value>plain</value><value><string/></value><value/>\n\
            <value><array><data>\n</data></array></value></data></array></value>\n</param></params>\n</methodResponse>";
        let expected =
            vec![Value::Int(1), Value::text("plain"), Value::text(""), Value::text(""), Value::Array(Vec::new())];
        assert_eq!(parse_response(text), Ok(Response::Value(Value::Array(expected))));
        let call = "<methodCall><methodName>getPid</methodName></methodCall>";
        assert_eq!(parse_call(call), Ok(("getPid".into(), Vec::new())));
        assert_eq!(parse_response(&write_fault(-1, "no <such> thing")), Ok(Response::Fault("no <such> thing".into())));
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
            prop_assert_eq!(parse_response(&write_response(&value)), Ok(Response::Value(value.clone())));
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
