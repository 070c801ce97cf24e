//! Completions for a word of a command line, read from a home without a site. Bounded and silent on errors. Offers only
//! words that every shell reads as one plain word: names in a ledger may come from strangers.

use crate::model::{ContactName, ProfileName, TopicName};
use crate::paths::Home;
use crate::store::Glance;
use crate::store::notes::AddressBook;

const MOST: usize = 200;

/// A kind of word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Completed {
    /// A topic with records.
    Topic,
    Contact,
    Record,
    Profile,
}

/// Words of a kind with this prefix; none if the home cannot be read.
pub fn words(home: &Home, kind: Completed, begun: &str) -> Vec<String> {
    let glance = || Glance::at(&home.ledger()).ok();
    let found = match kind {
        Completed::Topic => glance().and_then(|glance| glance.topics(begun, MOST).ok()),
        Completed::Record => glance().and_then(|glance| glance.ids(begun, MOST).ok()),
        Completed::Contact => glance().and_then(|glance| contacts(&glance)),
        Completed::Profile => Some(home.profiles().iter().map(ProfileName::to_string).collect()),
    };
    let begins = |word: &str| match kind {
        Completed::Record => word.starts_with(&begun.to_ascii_lowercase()) || word.starts_with(begun),
        _ => word.starts_with(begun),
    };
    found.unwrap_or_default().into_iter().filter(|word| is_plain(kind, word) && begins(word)).take(MOST).collect()
}

/// Whether a word has the form of its kind; none of these forms contains a shell's special character.
fn is_plain(kind: Completed, word: &str) -> bool {
    match kind {
        Completed::Topic => word.parse::<TopicName>().is_ok(),
        Completed::Contact => word.parse::<ContactName>().is_ok(),
        Completed::Profile => word.parse::<ProfileName>().is_ok(),
        Completed::Record => !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_hexdigit()),
    }
}

fn contacts(glance: &Glance) -> Option<Vec<String>> {
    let book = glance.note(&AddressBook {}).ok()??;
    Some(book.into_iter().map(|contact| contact.name.to_string()).collect())
}

#[cfg(test)]
#[path = "../../../tests/support/hostile.rs"]
#[allow(dead_code, reason = "the flows use the rest")]
mod hostile;

#[cfg(test)]
mod tests {
    use super::hostile::Hostile;
    use super::*;
    use crate::model::SignerId;
    use crate::site::testing::Ground;

    const KINDS: [Completed; 4] = [Completed::Topic, Completed::Contact, Completed::Record, Completed::Profile];

    #[test]
    fn names_that_a_shell_would_run_are_no_words() {
        let hostile =
            ["/x;touch${IFS}/tmp/pwned", "/x$(id)", "/`id`", "/*", "/a b", "/a\nb", "a&b", "~", "-rf", "", "'"];
        for kind in KINDS {
            assert!(hostile.iter().all(|word| !is_plain(kind, word)), "{kind:?}");
        }
        assert!(is_plain(Completed::Topic, "/robot1/odom") && is_plain(Completed::Contact, "bob.smith-2"));
        assert!(is_plain(Completed::Record, "00ff") && is_plain(Completed::Profile, "default"));
    }

    fn is_plain_to_shells(character: char) -> bool {
        character.is_ascii_alphanumeric() || "/_.-".contains(character)
    }

    #[test]
    fn a_word_consists_of_characters_without_a_meaning_to_any_shell() {
        let characters = (0_u8..=127).map(char::from).chain("\u{a0}\u{202e}\u{200b}\u{ff0f}ä".chars());
        for character in characters.filter(|character| !is_plain_to_shells(*character)) {
            for word in
                [format!("/a{character}b"), format!("/{character}"), format!("a{character}"), character.to_string()]
            {
                assert!(KINDS.iter().all(|kind| !is_plain(*kind, &word)), "{word:?}");
            }
        }
    }

    /// One word, which every shell takes as it is.
    fn is_harmless(word: &str) -> bool {
        !word.is_empty() && !word.starts_with('-') && word.chars().all(is_plain_to_shells)
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn of_hostile_names_no_word_is_offered_that_a_shell_would_read_otherwise() {
        let mut hostile = Hostile::new(0x7ab);
        let wanted = if std::env::var_os("AUTHROS_LONG").is_some() { 1_000_000 } else { 20_000 };
        while hostile.names < wanted {
            let name = hostile.name();
            assert!(KINDS.iter().all(|kind| !is_plain(*kind, &name) || is_harmless(&name)), "{name:?}");
        }
        let (ground, signer) = (Ground::with(&[]), SignerId([1; 32]));
        let owner = ground.owner("alice").address;
        for second in 1..=200 {
            ground.capture(owner, signer, &hostile.name(), second);
        }
        ground.capture(owner, signer, "/robot2/odom", 300);
        let offered = words(ground.home(), Completed::Topic, "/");
        assert!(
            offered.contains(&"/robot2/odom".to_owned()) && offered.iter().all(|word| is_harmless(word)),
            "{offered:?}"
        );
    }
}
