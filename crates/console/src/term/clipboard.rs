//! Copying by OSC 52: the text is sent to the terminal, which may or may not take it.

/// The most bytes sent; longer texts belong into files.
const MOST: usize = 4_096;

/// The sequence that offers `text` to the terminal's clipboard.
pub fn sequence(text: &str) -> String {
    let text = &text[..text.floor_char_boundary(MOST)];
    format!("\x1b]52;c;{}\x07", base64(text.as_bytes()))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let part = |index: usize| u32::from(chunk.get(index).copied().unwrap_or(0));
        let bits = part(0) << 16 | part(1) << 8 | part(2);
        for place in 0..4u32 {
            let digit = usize::try_from(bits >> (18 - 6 * place) & 63).unwrap_or(0);
            let used = usize::try_from(place).is_ok_and(|place| place <= chunk.len());
            text.push(if used { char::from(DIGITS[digit]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rfc4648_examples() {
        let pairs = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (text, wanted) in pairs {
            assert_eq!(base64(text.as_bytes()), wanted);
        }
        assert_eq!(sequence("f"), "\x1b]52;c;Zg==\x07");
        assert!(sequence(&"é".repeat(5_000)).len() < 6_000);
    }
}
