//! One line of a ROS 2 `.msg` text: a field with its bounds, a constant, or nothing.

use super::super::line::Primitive;

/// The most digits of a number, including leading zeros: the text is kept, and shown with every array.
const LONGEST_NUMBER: usize = 20;

/// How many of its type a field holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Many {
    One,
    Fixed(usize),
    /// At most this many.
    Bounded(usize),
    Any,
}

/// A meaningful line. Default values and the values of constants are not part of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Line<'a> {
    Field {
        /// The type as written, with its bounds.
        written: &'a str,
        base: &'a str,
        /// The most characters of a text; 0 if unbounded.
        bound: usize,
        many: Many,
        name: &'a str,
    },
    Constant,
}

/// A type that needs no definition: its layout in a body, and its number in type descriptions.
pub(super) fn plain(base: &str) -> Option<(Primitive, u8)> {
    Some(match base {
        "int8" => (Primitive::Int8, 2),
        // In ROS 2 a char is an eight-bit number.
        "uint8" | "char" => (Primitive::Uint8, 3),
        "int16" => (Primitive::Int16, 4),
        "uint16" => (Primitive::Uint16, 5),
        "int32" => (Primitive::Int32, 6),
        "uint32" => (Primitive::Uint32, 7),
        "int64" => (Primitive::Int64, 8),
        "uint64" => (Primitive::Uint64, 9),
        "float32" => (Primitive::Float32, 10),
        "float64" => (Primitive::Float64, 11),
        "bool" => (Primitive::Bool, 15),
        "byte" => (Primitive::Uint8, 16),
        "string" => (Primitive::Text, 17),
        "wstring" => (Primitive::Wide, 18),
        _ => return None,
    })
}

/// Parses one line; `None` if it is blank or a comment.
pub(super) fn parse_line(line: &str) -> Result<Option<Line<'_>>, &'static str> {
    let line = without_comment(line).trim();
    if line.is_empty() {
        return Ok(None);
    }
    let (written, rest) = line.split_once(char::is_whitespace).ok_or("a line has no field name")?;
    let rest = rest.trim_start();
    if rest.split_once('=').is_some_and(|(name, _)| is_name(name.trim_end())) {
        return if plain(written_base(written)).is_some() {
            Ok(Some(Line::Constant))
        } else {
            Err("a constant is broken")
        };
    }
    // The default value follows the name.
    let name = rest.split(char::is_whitespace).next().unwrap_or_default();
    field(written, name).map(Some)
}

/// The line up to its comment; a `#` between quotes does not begin one.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    let mut escaped = false;
    for (at, character) in line.char_indices() {
        match (quote, character) {
            _ if escaped => escaped = false,
            (Some(_), '\\') => escaped = true,
            (Some(open), close) if open == close => quote = None,
            (None, '#') => return line.get(..at).unwrap_or_default(),
            (None, '"' | '\'') => quote = Some(character),
            _ => {}
        }
    }
    // An unclosed quote is an ordinary character.
    if quote.is_some() { line.split('#').next().unwrap_or_default() } else { line }
}

fn field<'a>(written: &'a str, name: &'a str) -> Result<Line<'a>, &'static str> {
    let bounded = |text: &str| text.len() <= LONGEST_NUMBER;
    let number = |text: &str| text.parse().ok().filter(|count: &usize| *count > 0 && bounded(text));
    let (element, many) = match written.strip_suffix(']').and_then(|inner| inner.rsplit_once('[')) {
        None => (written, Many::One),
        Some((element, "")) => (element, Many::Any),
        Some((element, count)) => {
            let many = match count.strip_prefix("<=") {
                Some(most) => number(most).map(Many::Bounded),
                None => number(count).map(Many::Fixed),
            };
            (element, many.ok_or("an array has a broken length")?)
        }
    };
    let (base, bound) = match element.split_once("<=") {
        Some((base @ ("string" | "wstring"), most)) => (base, number(most).ok_or("a text has a broken bound")?),
        Some(_) => return Err("a bound where none is allowed"),
        None => (element, 0),
    };
    let mut parts = base.split('/');
    let base_ok = parts.by_ref().take(3).all(is_name) && parts.next().is_none();
    if !base_ok || !is_name(name) {
        return Err("a field is broken");
    }
    Ok(Line::Field { written, base, bound, many, name })
}

fn written_base(written: &str) -> &str {
    written.split_once("<=").map_or(written, |(base, _)| base)
}

/// Whether it is valid as the name of a field, a package or a type.
pub(super) fn is_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    name.len() <= 255
        && bytes.next().is_some_and(|byte| byte.is_ascii_alphabetic() || byte == b'_')
        && bytes.all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> (String, usize, Many, String) {
        match parse_line(line) {
            Ok(Some(Line::Field { base, bound, many, name, .. })) => (base.to_owned(), bound, many, name.to_owned()),
            other => panic!("{line}: {other:?}"),
        }
    }

    #[test]
    fn fields_have_bounds_and_default_values() {
        let cases = [
            ("  float64[36]\tc # six by six", ("float64", 0, Many::Fixed(36), "c")),
            ("string<=10 s \"a # b\" # why", ("string", 10, Many::One, "s")),
            ("wstring<=3[<=4] w", ("wstring", 3, Many::Bounded(4), "w")),
            ("geometry_msgs/msg/Point[] points", ("geometry_msgs/msg/Point", 0, Many::Any, "points")),
            ("int32[] numbers [1, 2]", ("int32", 0, Many::Any, "numbers")),
            ("string text 'a=b'", ("string", 0, Many::One, "text")),
            ("string note # don't", ("string", 0, Many::One, "note")),
        ];
        for (line, (base, bound, many, name)) in cases {
            assert_eq!(read(line), (base.to_owned(), bound, many, name.to_owned()), "{line}");
        }
    }

    #[test]
    fn constants_and_empty_lines_carry_nothing() {
        for line in ["int8 B = -1 # minus", "string A=\"x # y\"", "string<=5 A='b'", "byte OK=0"] {
            assert_eq!(parse_line(line), Ok(Some(Line::Constant)), "{line}");
        }
        for line in ["", "   ", "# only words", "\t# don't"] {
            assert_eq!(parse_line(line), Ok(None), "{line}");
        }
    }

    #[test]
    fn what_is_no_line_is_refused() {
        for bad in [
            "float64",
            "x[ y",
            "a/b/c/d e",
            "int8[-1] x",
            "int8[0] x",
            "int8[<=0] x",
            "int8<=3 x",
            "foo A=1",
            "1a b",
            "a// b",
            "string<= x",
            &format!("string<={}1 x", "0".repeat(LONGEST_NUMBER)),
            "int8[<=99999999999999999999] x",
        ] {
            assert!(parse_line(bad).is_err(), "{bad}");
        }
    }
}
