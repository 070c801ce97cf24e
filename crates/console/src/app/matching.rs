//! Search as it is typed: whole words, or letters in their order.

/// Letters of every word must occur in order; lower is better, `None` = no match.
pub fn score(needle: &str, text: &str) -> Option<usize> {
    let text: Vec<char> = text.chars().flat_map(char::to_lowercase).collect();
    needle.split_whitespace().map(|word| word_score(word, &text)).sum()
}

/// Rows with every word as typed, or if there are none, rows with the letters in order.
pub fn narrow<T>(needle: &str, rows: Vec<T>, text: impl Fn(&T) -> String) -> Vec<T> {
    if needle.trim().is_empty() {
        return rows;
    }
    let whole: Vec<bool> = rows.iter().map(|row| whole_words(needle, &text(row))).collect();
    let any = whole.contains(&true);
    let kept = rows.into_iter().zip(whole);
    kept.filter(|(row, whole)| *whole || !any && score(needle, &text(row)).is_some()).map(|(row, _)| row).collect()
}

pub fn whole_words(needle: &str, text: &str) -> bool {
    let text = text.to_lowercase();
    needle.split_whitespace().all(|word| text.contains(&word.to_lowercase()))
}

/// Distances between the letters, and of the first from the beginning.
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

/// Longest common beginning.
pub fn common<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<String> {
    let first = names.next()?.to_owned();
    Some(names.fold(first, |common, name| {
        let same = common.chars().zip(name.chars()).take_while(|(one, other)| one == other);
        same.map(|(character, _)| character).collect()
    }))
}

#[cfg(test)]
mod fuzzy_tests {
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
