//! Text that tries to control a terminal, and the check that none of it gets through.

/// Hostile pieces: control sequences from both ends of the range, direction, invisibility, wide and broken characters.
const PIECES: [&str; 18] = [
    "\u{1b}[2J",
    "\u{1b}]0;owned\u{7}",
    "\u{1b}]52;c;b3duZWQ=\u{7}",
    "\u{1b}P+q\u{1b}\\",
    "\u{9b}31m",
    "\u{9d}0;x\u{9c}",
    "\u{90}",
    "\r\n",
    "\u{8}\u{8}\u{7f}",
    "\u{202e}dmo\u{202c}",
    "\u{2066}\u{2069}",
    "\u{200b}\u{200f}\u{feff}",
    "\u{e0041}\u{fe0f}",
    "e\u{301}\u{301}\u{301}\u{301}\u{301}\u{301}",
    "机器",
    "/robot1/odom",
    "\u{0}",
    "\u{85}\u{2028}",
];

/// A source of hostile text, the same for the same seed.
pub struct Hostile(u64);

impl Hostile {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed | 1)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// One text: pieces, and single characters of the whole range.
    pub fn text(&mut self) -> String {
        let length = self.next() % 6 + 1;
        let mut text = String::new();
        for _ in 0..length {
            let random = self.next();
            if random.is_multiple_of(3) {
                let code = u32::try_from(random >> 8 & 0x1f_ffff).expect("21 bits");
                text.extend(char::from_u32(code % 0x11_0000));
            } else {
                let piece = usize::try_from(random >> 8 & 0xffff).expect("16 bits") % PIECES.len();
                text.push_str(PIECES[piece]);
            }
        }
        text
    }
}

/// Where bytes for a terminal contain something that is not the console's own: it writes text, and of control sequences
/// only movement, styles, clearing and modes.
pub fn foreign(bytes: &[u8]) -> Option<String> {
    let Ok(text) = std::str::from_utf8(bytes) else { return Some("not UTF-8".to_owned()) };
    let mut rest = text;
    while let Some(character) = rest.chars().next() {
        if let Some(sequence) = rest.strip_prefix("\u{1b}[") {
            let end = sequence.find(|c: char| !(c.is_ascii_digit() || matches!(c, ';' | '?')));
            let last = end.and_then(|end| sequence[end..].chars().next());
            match (end, last) {
                (Some(end), Some('H' | 'C' | 'm' | 'J' | 'h' | 'l')) => rest = &sequence[end + 1..],
                _ => return Some(format!("a sequence of others: {:?}", sequence.chars().take(12).collect::<String>())),
            }
            continue;
        }
        if !harmless(character) {
            return Some(format!("{character:?} before {:?}", rest.chars().take(12).collect::<String>()));
        }
        rest = &rest[character.len_utf8()..];
    }
    None
}

/// What a terminal would interpret in plain lines (output, JSON, logs).
pub fn foreign_in_lines(text: &str) -> Option<char> {
    text.chars().find(|character| *character != '\n' && !harmless(*character))
}

fn harmless(character: char) -> bool {
    !(character.is_control()
        || matches!(character, '\u{ad}' | '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{e0000}'..='\u{e0fff}'))
}

#[test]
fn the_look_out_sees_what_is_hostile() {
    assert_eq!(foreign(b"\x1b[?2026h\x1b[1;2H\x1b[0;38;5;12mabc\x1b[m\x1b[2J\x1b[?2026l"), None);
    for bad in ["\u{1b}]0;x\u{7}", "\u{1b}c", "a\u{9b}", "\u{1b}[5A", "\u{202e}", "a\r", "\u{200b}"] {
        assert!(foreign(bad.as_bytes()).is_some(), "{bad:?}");
    }
    let mut hostile = Hostile::new(7);
    let caught = (0..1000).filter(|_| foreign(hostile.text().as_bytes()).is_some()).count();
    assert!(caught > 800, "{caught}");
}
