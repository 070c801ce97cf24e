//! Fuzzy match for palette and filters.

/// How well `needle` matches: every word of it must be found in `text`, in order of its
/// letters; lower is better, `None` is no match. An empty needle matches everything with 0.
pub fn score(needle: &str, text: &str) -> Option<usize> {
    let text: Vec<char> = text.chars().flat_map(char::to_lowercase).collect();
    needle.split_whitespace().map(|word| word_score(word, &text)).sum()
}

/// The matching rows: those that contain every word as it is, or if there are none, those that contain its letters in
/// order.
pub fn narrow<T>(needle: &str, rows: Vec<T>, text: impl Fn(&T) -> String) -> Vec<T> {
    if needle.trim().is_empty() {
        return rows;
    }
    let needle = needle.to_lowercase();
    let words: Vec<&str> = needle.split_whitespace().collect();
    let whole: Vec<bool> = rows.iter().map(|row| holds_all(&words, &text(row))).collect();
    let any = whole.contains(&true);
    let kept = rows.into_iter().zip(whole);
    kept.filter(|(row, whole)| *whole || !any && score(&needle, &text(row)).is_some()).map(|(row, _)| row).collect()
}

/// Whether `text` contains all words, which are in lower case.
fn holds_all(words: &[&str], text: &str) -> bool {
    let text = text.to_lowercase();
    words.iter().all(|word| text.contains(word))
}

/// Whether `text` contains every word of `needle` as it is.
pub fn whole_words(needle: &str, text: &str) -> bool {
    let text = text.to_lowercase();
    needle.split_whitespace().all(|word| text.contains(&word.to_lowercase()))
}

/// The distance of the letters from each other, and of the first one from the beginning.
fn word_score(word: &str, text: &[char]) -> Option<usize> {
    let word: Vec<char> = word.chars().flat_map(char::to_lowercase).collect();
    let whole = text.windows(word.len().max(1)).position(|part| part == word.as_slice());
    whole.map(|at| usize::from(at > 0)).or_else(|| scattered(&word, text))
}

fn scattered(word: &[char], text: &[char]) -> Option<usize> {
    let mut from = 0;
    let mut gaps = 10;
    for letter in word {
        let found = text.get(from..)?.iter().position(|other| other == letter)?;
        gaps += found;
        from += found + 1;
    }
    Some(gaps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_match_in_any_order_and_letters_in_their_own() {
        assert_eq!(score("", "anything"), Some(0));
        assert_eq!(score("odom", "/robot1/odom"), Some(1));
        assert!(score("r1odm", "/robot1/odom").is_some());
        assert!(score("odom robot1", "/robot1/odom").is_some());
        assert_eq!(score("mdo", "/robot1/odom"), None);
        assert!(score("gr", "grant") < score("gr", "go-overview first"));
        assert_eq!(score("X", ""), None);
    }

    #[test]
    fn scattered_letters_count_only_where_no_whole_word_does() {
        let narrowed = |needle| narrow(needle, vec!["/robot1/camera/odometer", "/robot1/odom"], ToString::to_string);
        assert_eq!(narrowed("robot1/odom"), ["/robot1/odom"]);
        assert_eq!(narrowed("rbtcmr"), ["/robot1/camera/odometer"]);
        assert_eq!(narrowed("").len(), 2);
    }
}
