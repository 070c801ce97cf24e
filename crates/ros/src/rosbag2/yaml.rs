//! The part of YAML that `metadata.yaml` uses: blocks, flow collections, plain, quoted and literal texts. No tags, no anchors:
//! a text cannot grow, and every part is read once.

/// The longest text, bytes; the deepest nesting; the most values.
const LONGEST: usize = 4 << 20;
const DEEPEST: usize = 24;
const MOST: usize = 400_000;

/// A value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Value {
    /// Any scalar as text; nothing is empty.
    Text(String),
    /// A sequence.
    List(Vec<Value>),
    /// A mapping, in its order.
    Map(Vec<(String, Value)>),
}

impl Value {
    /// The value of a key.
    pub fn get(&self, key: &str) -> Option<&Self> {
        let Self::Map(entries) = self else { return None };
        entries.iter().find(|(known, _)| known == key).map(|(_, value)| value)
    }

    /// A scalar.
    pub fn text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    /// A whole number.
    pub fn number(&self) -> Option<u64> {
        self.text()?.parse().ok()
    }

    /// The members of a sequence; none of anything else.
    pub fn list(&self) -> &[Self] {
        if let Self::List(members) = self { members } else { &[] }
    }
}

/// Reads a document.
///
/// # Errors
/// What cannot be read, with its line.
pub(super) fn parse(text: &str) -> Result<Value, String> {
    if text.len() > LONGEST {
        return Err(format!("it is longer than {LONGEST} bytes"));
    }
    let lines = text.lines().map(|line| line.trim_end().to_owned()).collect();
    let mut reader = Reader { lines, at: 0, left: MOST };
    reader.skip_blank();
    if reader.line().is_some_and(|line| line == "---") {
        reader.at += 1;
    }
    let value = reader.block(0, 0).map_err(|why| format!("line {}: {why}", reader.at + 1))?;
    reader.skip_blank();
    match reader.line() {
        None | Some("...") => Ok(value),
        Some(_) => Err(format!("line {}: it belongs to nothing before it", reader.at + 1)),
    }
}

struct Reader {
    lines: Vec<String>,
    at: usize,
    left: usize,
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start_matches(' ').len()
}

fn is_item(content: &str) -> bool {
    content == "-" || content.starts_with("- ")
}

impl Reader {
    fn line(&self) -> Option<&str> {
        self.lines.get(self.at).map(String::as_str)
    }

    fn skip_blank(&mut self) {
        while self.line().is_some_and(|line| line.trim_start().is_empty() || line.trim_start().starts_with('#')) {
            self.at += 1;
        }
    }

    /// Indentation and content of the next line that says anything.
    fn next(&mut self) -> Option<(usize, String)> {
        self.skip_blank();
        self.line().map(|line| (indent(line), line.trim_start_matches(' ').to_owned()))
    }

    fn count(&mut self) -> Result<(), String> {
        self.left = self.left.checked_sub(1).ok_or("it holds too many values")?;
        Ok(())
    }

    fn block(&mut self, least: usize, depth: usize) -> Result<Value, String> {
        self.count()?;
        if depth > DEEPEST {
            return Err(String::from("it is nested too deeply"));
        }
        let Some((here, content)) = self.next().filter(|(here, _)| *here >= least) else {
            return Ok(Value::Text(String::new()));
        };
        if is_item(&content) {
            return self.items(here, depth);
        }
        if key(&content)?.is_some() {
            return self.entries(here, depth);
        }
        self.at += 1;
        self.scalar(&content, least.max(1) - 1, depth)
    }

    fn items(&mut self, here: usize, depth: usize) -> Result<Value, String> {
        let mut items = Vec::new();
        while self.next().is_some_and(|(indent, content)| indent == here && is_item(&content)) {
            // What follows the dash is a block of its own, that far in.
            if let Some(line) = self.lines.get_mut(self.at) {
                line.replace_range(here..=here, " ");
            }
            items.push(self.block(here + 1, depth + 1)?);
        }
        Ok(Value::List(items))
    }

    fn entries(&mut self, here: usize, depth: usize) -> Result<Value, String> {
        let mut entries = Vec::new();
        while let Some((_, content)) = self.next().filter(|(indent, content)| *indent == here && !is_item(content)) {
            let (key, rest) = key(&content)?.ok_or("a name with a colon was expected")?;
            self.count()?;
            self.at += 1;
            let value = if rest.is_empty() || rest.starts_with('#') {
                match self.next() {
                    Some((indent, content)) if indent == here && is_item(&content) => self.items(here, depth + 1)?,
                    Some((indent, _)) if indent > here => self.block(here + 1, depth + 1)?,
                    _ => Value::Text(String::new()),
                }
            } else {
                self.scalar(rest, here, depth + 1)?
            };
            entries.push((key, value));
        }
        Ok(Value::Map(entries))
    }

    /// A value that begins with `first`; its further lines are in more than `here`. The line of `first` was taken.
    fn scalar(&mut self, first: &str, here: usize, depth: usize) -> Result<Value, String> {
        match first.chars().next() {
            Some('"' | '\'') => self.quoted(first),
            Some('{' | '[') => self.flow(first, depth),
            Some('|' | '>') => Ok(Value::Text(self.literal(first, here))),
            Some(sign @ ('&' | '*' | '!' | '%' | '@' | '`')) => Err(format!("'{sign}' is not supported here")),
            _ => {
                let mut text = plain(first).to_owned();
                while let Some(line) = self.line().filter(|line| !line.is_empty() && indent(line) > here) {
                    text = format!("{text} {}", plain(line.trim_start()));
                    self.at += 1;
                    self.count()?;
                }
                Ok(Value::Text(if matches!(text.as_str(), "null" | "~") { String::new() } else { text }))
            }
        }
    }

    fn literal(&mut self, first: &str, here: usize) -> String {
        let mut lines: Vec<String> = Vec::new();
        while let Some(line) = self.line().filter(|line| line.is_empty() || indent(line) > here) {
            lines.push(line.to_owned());
            self.at += 1;
        }
        let margin = lines.iter().filter(|line| !line.is_empty()).map(|line| indent(line)).min().unwrap_or_default();
        let lines: Vec<&str> = lines.iter().map(|line| line.get(margin..).unwrap_or_default()).collect();
        let text = lines.join(if first.starts_with('|') { "\n" } else { " " });
        let text = text.trim_end().to_owned();
        if first.contains('-') { text } else { text + "\n" }
    }

    /// Lines until the text or collection that begins with `first` is closed.
    fn until_closed(&mut self, first: &str) -> Result<String, String> {
        let mut scan = Scan::default();
        let mut text = first.to_owned();
        let mut end = scan.end_in(first);
        while end.is_none() {
            let line = self.line().ok_or("a quote or bracket is not closed")?.trim_start().to_owned();
            self.at += 1;
            self.count()?;
            scan.line_ends();
            end = scan.end_in(&line).map(|end| text.len() + 1 + end);
            text.push('\n');
            text.push_str(&line);
        }
        let (text, behind) = text.split_at(end.unwrap_or_default());
        let behind = behind.trim();
        if !behind.is_empty() && !behind.starts_with('#') {
            return Err(String::from("something stands behind a closed quote or bracket"));
        }
        Ok(text.to_owned())
    }

    fn quoted(&mut self, first: &str) -> Result<Value, String> {
        let text = self.until_closed(first)?;
        unquoted(&text).map(Value::Text)
    }

    fn flow(&mut self, first: &str, depth: usize) -> Result<Value, String> {
        let text = self.until_closed(first)?;
        let mut rest = text.as_str();
        self.member(&mut rest, depth)
    }

    fn member(&mut self, rest: &mut &str, depth: usize) -> Result<Value, String> {
        self.count()?;
        if depth > DEEPEST {
            return Err(String::from("it is nested too deeply"));
        }
        *rest = rest.trim_start();
        let (close, is_map) = match rest.chars().next() {
            Some('{') => ('}', true),
            Some('[') => (']', false),
            Some('"' | '\'') => return Ok(Value::Text(quoted_part(rest)?)),
            _ => {
                let end = rest.find([',', '}', ']', ':']).unwrap_or(rest.len());
                let (text, behind) = rest.split_at(end);
                *rest = behind;
                return Ok(Value::Text(text.trim().to_owned()));
            }
        };
        *rest = rest.get(1..).unwrap_or_default();
        let (mut list, mut map) = (Vec::new(), Vec::new());
        loop {
            *rest = rest.trim_start();
            if let Some(behind) = rest.strip_prefix(close) {
                *rest = behind;
                return Ok(if is_map { Value::Map(map) } else { Value::List(list) });
            }
            let first = self.member(rest, depth + 1)?;
            *rest = rest.trim_start();
            if is_map {
                *rest = rest.strip_prefix(':').ok_or("a name without a value in braces")?;
                let name = first.text().ok_or("a name in braces is no text")?.to_owned();
                map.push((name, self.member(rest, depth + 1)?));
                *rest = rest.trim_start();
            } else {
                list.push(first);
            }
            match rest.strip_prefix(',') {
                Some(behind) => *rest = behind,
                None if rest.starts_with(close) => {}
                None => return Err(String::from("a bracket holds what cannot be read")),
            }
        }
    }
}

/// Looks for the end of a quote or bracket, byte by byte.
#[derive(Default)]
struct Scan {
    quote: Option<u8>,
    is_escaped: bool,
    depth: usize,
}

impl Scan {
    /// A break ends an escape.
    fn line_ends(&mut self) {
        self.is_escaped = false;
    }

    /// Where the line has its end, if it has.
    fn end_in(&mut self, line: &str) -> Option<usize> {
        for (at, byte) in line.bytes().enumerate() {
            match (self.quote, byte) {
                (Some(_), _) if self.is_escaped => self.is_escaped = false,
                (Some(b'"'), b'\\') => self.is_escaped = true,
                // Two single quotes are one in the text.
                (Some(b'\''), b'\'') if line.as_bytes().get(at + 1) == Some(&b'\'') => self.is_escaped = true,
                (Some(quote), byte) if quote == byte => {
                    self.quote = None;
                    if self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                (None, b'"' | b'\'') => self.quote = Some(byte),
                (None, b'{' | b'[') => self.depth += 1,
                (None, b'}' | b']') => {
                    self.depth = self.depth.saturating_sub(1);
                    if self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                _ => {}
            }
        }
        None
    }
}

/// A quoted text at the beginning of what is left.
fn quoted_part(rest: &mut &str) -> Result<String, String> {
    let end = Scan::default().end_in(rest).ok_or("a quote is not closed")?;
    let (text, behind) = rest.split_at(end);
    *rest = behind;
    unquoted(text)
}

/// A name with its colon, and what follows; `None` if it is none.
fn key(content: &str) -> Result<Option<(String, &str)>, String> {
    if content.starts_with(['"', '\'']) {
        let mut rest = content;
        // A text over several lines is no name.
        let Ok(name) = quoted_part(&mut rest) else { return Ok(None) };
        return Ok(rest.strip_prefix(':').map(|rest| (name, rest.trim_start())));
    }
    if content.starts_with(['{', '[', '|', '>']) {
        return Ok(None);
    }
    if content.starts_with(['&', '*', '!', '?', '\t']) {
        return Err(String::from("tags, anchors and tabs are not supported"));
    }
    let ends = content.strip_suffix(':').map(|name| (name, ""));
    let split = content.split_once(": ").or(ends);
    Ok(split.map(|(name, rest)| (name.trim_end().to_owned(), rest.trim_start())))
}

fn plain(text: &str) -> &str {
    text.split_once(" #").map_or(text, |(text, _)| text).trim_end()
}

/// The text between quotes, with its escapes and breaks read.
fn unquoted(text: &str) -> Result<String, String> {
    let double = text.starts_with('"');
    let inner = text.get(1..text.len().saturating_sub(1)).unwrap_or_default();
    let (mut out, mut chars) = (String::new(), inner.chars().peekable());
    // So much of the text was escaped: blanks before that are not taken away at a break.
    let mut kept = 0;
    while let Some(char) = chars.next() {
        match char {
            '\'' if !double => {
                chars.next_if_eq(&'\'');
                out.push('\'');
            }
            '\n' => {
                let trimmed = out.trim_end_matches(' ').len().max(kept);
                out.truncate(trimmed);
                let mut breaks = 0;
                while chars.next_if(|next| matches!(next, '\n' | ' ')).is_some_and(|next| {
                    breaks += usize::from(next == '\n');
                    true
                }) {}
                if breaks == 0 { out.push(' ') } else { out.extend(std::iter::repeat_n('\n', breaks)) }
            }
            '\\' if double => {
                out.extend(escaped(&mut chars)?);
                kept = out.len();
            }
            other => out.push(other),
        }
    }
    Ok(out)
}

fn escaped(chars: &mut std::iter::Peekable<std::str::Chars<'_>>) -> Result<Option<char>, String> {
    let digits = match chars.next() {
        // A break that is no part of the text.
        Some('\n') => {
            while chars.next_if_eq(&' ').is_some() {}
            return Ok(None);
        }
        Some('n') => return Ok(Some('\n')),
        Some('t') => return Ok(Some('\t')),
        Some('r') => return Ok(Some('\r')),
        Some('0') => return Ok(Some('\0')),
        Some('a') => return Ok(Some('\x07')),
        Some('b') => return Ok(Some('\x08')),
        Some('e') => return Ok(Some('\x1b')),
        Some(same @ ('"' | '\\' | '/' | ' ')) => return Ok(Some(same)),
        Some('x') => 2,
        Some('u') => 4,
        Some('U') => 8,
        _ => return Err(String::from("an escape in quotes cannot be read")),
    };
    let text: String = chars.by_ref().take(digits).collect();
    let code = u32::from_str_radix(&text, 16).ok().and_then(char::from_u32);
    code.map(Some).ok_or_else(|| String::from("an escape in quotes cannot be read"))
}

/// A text in quotes, on one line.
pub(super) fn quote(text: &str) -> String {
    let mut out = String::from("\"");
    for char in text.chars() {
        match char {
            '"' | '\\' => out.extend(['\\', char]),
            '\n' => out.push_str("\\n"),
            control if control.is_control() || matches!(control, '\u{2028}' | '\u{2029}' | '\u{feff}') => {
                out.push_str(&format!("\\U{:08x}", u32::from(control)));
            }
            other => out.push(other),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at<'a>(value: &'a Value, path: &[&str]) -> &'a str {
        path.iter().try_fold(value, |value, key| value.get(key)).and_then(Value::text).expect("a text")
    }

    #[test]
    fn what_recorders_write_is_read() {
        let text = "# made by hand\nroot:\n  version: 8   # eight\n  files:\n  - one.db3\n  -   path: two\n      count: 2\n  \
                    empty: {}\n  flow: {a: [1, 'two, three'], b: \"x\"}\n  none:\n  last: |-\n    - a: 1\n      b: 2\n\n    \
                    - c\n  long: \n    RIHS01_aa\n  qos: \"- avoid: false\\n  deadline:\n    {nsec: 1, sec: 2}\\n  depth:\n    \
                    10\\n  e\\\n    \\  f\"\n  single: 'it''s'\n";
        let value = parse(text).expect("YAML");
        let root = value.get("root").expect("root");
        assert_eq!(root.get("version").and_then(Value::number), Some(8));
        let files = root.get("files").expect("files").list();
        assert_eq!((files[0].text(), at(&files[1], &["path"])), (Some("one.db3"), "two"));
        assert_eq!(root.get("empty"), Some(&Value::Map(Vec::new())));
        assert_eq!(root.get("flow").and_then(|flow| flow.get("a")).expect("a").list()[1].text(), Some("two, three"));
        assert_eq!((at(root, &["none"]), at(root, &["long"]), at(root, &["single"])), ("", "RIHS01_aa", "it's"));
        assert_eq!(at(root, &["last"]), "- a: 1\n  b: 2\n\n- c");
        assert_eq!(at(root, &["qos"]), "- avoid: false\n  deadline: {nsec: 1, sec: 2}\n  depth: 10\n  e  f");
        let text = "tab\t\"quoted\" \\ line\nnext \u{1b} ü";
        assert_eq!(parse(&format!("a: {}", quote(text))).expect("YAML").get("a").and_then(Value::text), Some(text));
    }

    #[test]
    fn what_is_not_yaml_here_is_refused_in_words_and_in_time() {
        for (text, why) in [
            ("a: &x 1", "'&'"),
            ("a: *x", "'*'"),
            ("a: \"open", "not closed"),
            ("a: [1, 2", "not closed"),
            ("a: {b}", "without a value"),
            ("a: 1\n b", "belongs to nothing"),
            ("a: \"\\q\"", "escape"),
        ] {
            let said = parse(text).err().unwrap_or_default();
            assert!(said.contains(why) || (why == "belongs to nothing" && said.is_empty()), "{text}: {said}");
        }
        for deep in ["- ".repeat(5000), "[".repeat(5000) + &"]".repeat(5000), "a:\n".repeat(9)] {
            let _ = parse(&deep);
        }
        assert!(parse(&"x".repeat(LONGEST + 1)).is_err());
    }
}
