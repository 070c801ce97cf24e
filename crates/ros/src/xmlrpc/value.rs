//! XML-RPC values and writing them as XML. Parsing is in `parse`.

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
    /// A text.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// The elements of an array.
    pub fn as_array(&self) -> Option<&[Value]> {
        if let Self::Array(items) = self { Some(items) } else { None }
    }

    /// The text.
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
