//! One line of a message definition: a field, a constant, or nothing. Types are not resolved here.

/// A type that needs no definition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Primitive {
    Bool,
    Int8,
    Uint8,
    Int16,
    Uint16,
    Int32,
    Uint32,
    Int64,
    Uint64,
    Float32,
    Float64,
    Text,
    /// A UTF-16 text, of ROS 2.
    Wide,
    Time,
    Duration,
}

impl Primitive {
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "int8" | "byte" => Self::Int8,
            "uint8" | "char" => Self::Uint8,
            "int16" => Self::Int16,
            "uint16" => Self::Uint16,
            "int32" => Self::Int32,
            "uint32" => Self::Uint32,
            "int64" => Self::Int64,
            "uint64" => Self::Uint64,
            "float32" => Self::Float32,
            "float64" => Self::Float64,
            "string" => Self::Text,
            "time" => Self::Time,
            "duration" => Self::Duration,
            _ => return None,
        })
    }

    /// Whether it is a text.
    pub fn is_text(self) -> bool {
        matches!(self, Self::Text | Self::Wide)
    }

    /// Size in bytes; for a text, the size of its length field.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 | Self::Text | Self::Wide => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 | Self::Time | Self::Duration => 8,
        }
    }
}

/// How many of its type a field holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arity {
    One,
    Fixed(usize),
    Variable,
}

/// A meaningful line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Line<'a> {
    Field { written: &'a str, base: &'a str, arity: Arity, name: &'a str },
    Constant { base: &'a str, name: &'a str, text: &'a str },
}

/// Parses one line; `None` if it is blank or a comment.
pub(super) fn parse_line(line: &str) -> Result<Option<Line<'_>>, &'static str> {
    let plain = line.split('#').next().unwrap_or_default().trim();
    if plain.is_empty() {
        return Ok(None);
    }
    let (written, rest) = plain.split_once(char::is_whitespace).ok_or("a line has no field name")?;
    if plain.contains('=') { constant(line, written, rest).map(Some) } else { field(written, rest.trim()).map(Some) }
}

fn constant<'a>(line: &'a str, base: &'a str, rest: &'a str) -> Result<Line<'a>, &'static str> {
    let whole = if base == "string" {
        // A text constant extends to the end of its line, including '#'.
        line.trim_start().strip_prefix(base).ok_or("a constant is broken")?
    } else {
        rest
    };
    let (name, text) = whole.split_once('=').ok_or("a constant has no value")?;
    let (name, text) = (name.trim(), text.trim());
    let valid = Primitive::parse(base).is_some_and(|base| !matches!(base, Primitive::Time | Primitive::Duration));
    if valid && is_name(name) { Ok(Line::Constant { base, name, text }) } else { Err("a constant is broken") }
}

fn field<'a>(written: &'a str, name: &'a str) -> Result<Line<'a>, &'static str> {
    let (base, arity) = match written.strip_suffix(']').and_then(|inner| inner.rsplit_once('[')) {
        Some((base, "")) => (base, Arity::Variable),
        Some((base, count)) => (base, Arity::Fixed(count.parse().map_err(|_| "an array has a broken length")?)),
        None => (written, Arity::One),
    };
    let mut parts = base.split('/');
    let base_ok = parts.by_ref().take(2).all(is_name) && parts.next().is_none();
    if base_ok && is_name(name) { Ok(Line::Field { written, base, arity, name }) } else { Err("a field is broken") }
}

fn is_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    name.len() <= 255
        && bytes.next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_')
        && bytes.all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_and_constants() {
        let field = Line::Field { written: "float64[36]", base: "float64", arity: Arity::Fixed(36), name: "c" };
        assert_eq!(parse_line("  float64[36]\tc # six by six"), Ok(Some(field)));
        let constant = Line::Constant { base: "string", name: "A", text: "x # y = z" };
        assert_eq!(parse_line("string A= x # y = z "), Ok(Some(constant)));
        let constant = Line::Constant { base: "int8", name: "B", text: "-1" };
        assert_eq!(parse_line("int8 B = -1 # minus"), Ok(Some(constant)));
        assert_eq!(parse_line(" # only words"), Ok(None));
        for bad in ["float64", "a b c", "x[ y", "a/b/c d", "int8[-1] x", "foo A=1", "string #A=1", "1a b", "a// b"] {
            assert!(parse_line(bad).is_err(), "{bad}");
        }
    }
}
