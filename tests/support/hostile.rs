//! Text that tries to control a terminal, and the check that none of it gets through.

/// Hostile pieces: control sequences from both ends of the range, direction, invisibility, wide, joined and broken
/// characters, towers of marks, and what a shell would run.
const PIECES: [&str; 28] = [
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
    "\t\n",
    "👩\u{200d}👩\u{200d}👧\u{fe0f}🏽",
    "🇩🇪🇫",
    "\u{e49}\u{e49}\u{e49}\u{e49}\u{e49}\u{e49}\u{e49}\u{e49}",
    "لا\u{64b}\u{64b}\u{64b}\u{64b}\u{64b}\u{64b}",
    "क्षि\u{115f}\u{3164}",
    "\u{13437}\u{1bca0}\u{1d173}",
    "ｶﾞｏﾟ",
    "$(touch x);`id`|&>y '\" \\ * ~ #",
    "-rf --yes",
];

/// Pieces and the columns that a terminal needs for them once they are cleaned. Unicode's EastAsianWidth.txt says which
/// characters have two, combining marks have none, and each character that is taken away leaves a mark of one.
const MEASURED: [(&str, usize); 12] = [
    ("/robot1/odom", 12),
    ("机器", 4),
    ("한", 2),
    ("ｏ", 2),
    ("🤖", 2),
    ("e\u{301}", 1),
    ("\u{1b}[2J", 4),
    ("\u{9b}", 1),
    ("\u{202e}", 1),
    ("\r\n", 2),
    ("👩\u{200d}👧", 5),
    ("\u{1bca0}", 1),
];

/// Bytes of a very long name.
const LONGEST: usize = 64 * 1024;

/// A source of hostile text, the same for the same seed.
#[derive(Debug)]
pub struct Hostile {
    state: u64,
    /// Names so far.
    pub names: u64,
}

impl Hostile {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        Self { state: seed | 1, names: 0 }
    }

    fn next(&mut self) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        self.state
    }

    /// A number below `bound`, which is small.
    pub fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() >> 8 & 0xffff).expect("16 bits") % bound
    }

    /// A text, and once in a thousand times one of 64 KiB.
    pub fn name(&mut self) -> String {
        self.names += 1;
        let text = self.text();
        if self.below(1_000) > 0 { text } else { text.repeat(LONGEST / text.len().max(1) + 1) }
    }

    /// A short name, and the columns that a terminal needs for it once it is cleaned.
    pub fn measured(&mut self) -> (String, usize) {
        self.names += 1;
        let pieces: Vec<(&str, usize)> = (0..=self.below(4)).map(|_| MEASURED[self.below(MEASURED.len())]).collect();
        (pieces.iter().map(|(piece, _)| *piece).collect(), pieces.iter().map(|(_, columns)| columns).sum())
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
                text.push_str(PIECES[self.below(PIECES.len())]);
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

/// Neither a control nor one of Unicode's Default_Ignorable_Code_Point, line separators or joiners of hieroglyphs.
pub fn harmless(character: char) -> bool {
    !(character.is_control()
        || matches!(character, '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}'
            | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{3164}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}' | '\u{fff0}'..='\u{fffb}'
            | '\u{13430}'..='\u{1343f}' | '\u{1bca0}'..='\u{1bca3}' | '\u{1d173}'..='\u{1d17a}'
            | '\u{e0000}'..='\u{e0fff}'))
}

#[test]
fn the_look_out_sees_what_is_hostile() {
    assert_eq!(foreign(b"\x1b[?2026h\x1b[1;2H\x1b[0;38;5;12mabc\x1b[m\x1b[2J\x1b[?2026l"), None);
    for bad in ["\u{1b}]0;x\u{7}", "\u{1b}c", "a\u{9b}", "\u{1b}[5A", "\u{202e}", "a\r", "\u{200b}"] {
        assert!(foreign(bad.as_bytes()).is_some(), "{bad:?}");
    }
    let mut hostile = Hostile::new(7);
    let caught = (0..1000).filter(|_| foreign(hostile.text().as_bytes()).is_some()).count();
    // The rest is wide, long or for a shell, which no terminal minds.
    assert!(caught > 700, "{caught}");
}
