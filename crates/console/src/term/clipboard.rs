//! Copying with OSC 52: the text is sent to the terminal, which may or may not accept it.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// The most bytes sent; longer texts should be written to files.
const MOST: usize = 4_096;

/// The sequence that offers `text` to the terminal's clipboard.
pub fn sequence(text: &str) -> String {
    let text = &text[..text.floor_char_boundary(MOST)];
    format!("\x1b]52;c;{}\x07", STANDARD.encode(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rfc4648_examples() {
        let pairs = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (text, wanted) in pairs {
            assert_eq!(sequence(text), format!("\x1b]52;c;{wanted}\x07"));
        }
        assert!(sequence(&"é".repeat(5_000)).len() < 6_000);
    }
}
