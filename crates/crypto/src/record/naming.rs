//! Whether a record may bear the names in its sealed head. The holder of a topic key writes both the names and the
//! pseudonyms of the header; a name counts only if the pseudonym is the one derived from it.

use crate::crypto::{CryptoError, IndexKey, filter_id, filter_key, topic_filter_id, topic_id};
use crate::model::{FilterId, Head, Header, is_record_topic};

/// What a reader compares the names in a sealed head with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Names {
    /// The pseudonyms in the header, derived with IK of the record's owner.
    Derived(IndexKey),
    /// The topic's name as the owner gave it together with the topic key. Without IK, types and tags cannot be derived:
    /// they are the signer's claim about this one record.
    Given(String),
}

impl Names {
    /// Compares the names in a head with the header that it is sealed under.
    ///
    /// # Errors
    /// [`CryptoError::FalseName`] with the first name that does not belong to its pseudonym.
    pub fn check(&self, header: &Header, head: &Head) -> Result<(), CryptoError> {
        let false_name = match self {
            Self::Given(topic) => (head.topic != *topic).then_some("topic"),
            Self::Derived(index) => false_name(index, header, head),
        };
        false_name.map_or(Ok(()), |what| Err(CryptoError::FalseName(what)))
    }
}

fn false_name(index: &IndexKey, header: &Header, head: &Head) -> Option<&'static str> {
    if !is_record_topic(&head.topic) || topic_id(index, &head.topic) != header.topic_id {
        return Some("topic");
    }
    // A record without filter ids is found by no type and no tag; its names are about itself alone.
    let (of_type, of_tags) = header.filters.split_first()?;
    let own = filter_key(index, &header.topic_id);
    let is = |id: &FilterId, kind: &str, text: &str| {
        *id == filter_id(index, kind, text) || *id == topic_filter_id(&own, kind, text)
    };
    if !is(of_type, "type", &head.type_name) {
        return Some("type");
    }
    let tags: Vec<String> = head.tags.iter().map(|(name, value)| format!("{name}={value}")).collect();
    let is_tag = |id: &FilterId| tags.iter().any(|tag| is(id, "tag", tag));
    (!of_tags.iter().all(is_tag)).then_some("tags")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::record::tests::Sample;
    use crate::crypto::{ProviderName, SealRequest, seal};
    use crate::crypto::{provider, record::open_front};
    use crate::model::{ErrorKind, TopicId};

    fn index() -> IndexKey {
        IndexKey::new([3; 32])
    }

    fn id(topic: &str) -> TopicId {
        topic_id(&index(), topic)
    }

    /// What a reader with IK says of a record under these pseudonyms whose head names a topic, a type, and mission=7.
    fn read(topic_id: TopicId, filters: Vec<FilterId>, topic: &str, type_name: &str) -> Result<(), CryptoError> {
        let provider = provider(ProviderName::RustCrypto);
        let sample = Sample::new(ProviderName::RustCrypto, b"");
        let request = sample.request();
        let head = Head { topic: topic.to_owned(), type_name: type_name.to_owned(), ..request.head.clone() };
        let sealed = seal(provider, &SealRequest { topic_id, filters, head: &head, ..sample.request() });
        let blob = sealed.expect("seals").blob;
        open_front(provider, &blob, request.topic_key, &Names::Derived(index())).map(drop)
    }

    #[test]
    fn a_name_is_read_only_under_the_pseudonym_derived_from_it() {
        let (odom, kind) = ("/robot1/odom", "nav_msgs/Odometry");
        let (of_type, of_tag) = (filter_id(&index(), "type", kind), filter_id(&index(), "tag", "mission=7"));
        let own = filter_key(&index(), &id(odom));
        let of_robot = vec![topic_filter_id(&own, "type", kind), topic_filter_id(&own, "tag", "mission=7")];
        for filters in [vec![], vec![of_type], vec![of_type, of_tag], of_robot] {
            assert!(read(id(odom), filters, odom, kind).is_ok());
        }
        let refused = |found: Result<(), CryptoError>, field: &str| {
            let error = found.expect_err("refused");
            assert!(matches!(error, CryptoError::FalseName(what) if what == field), "{field}: {error}");
            assert_eq!(error.kind(), ErrorKind::Refused);
        };
        refused(read(id(odom), vec![], "/emergency_stop_released", kind), "topic");
        refused(read(id(odom), vec![of_type], odom, "std_msgs/Bool"), "type");
        refused(read(id(odom), vec![of_tag], odom, kind), "type");
        let of_other = filter_id(&index(), "tag", "mission=8");
        refused(read(id(odom), vec![of_type, of_other], odom, kind), "tags");
        let of_other_topic = topic_filter_id(&filter_key(&index(), &id("/a")), "type", kind);
        refused(read(id(odom), vec![of_other_topic], odom, kind), "type");
        // The holder of IK can derive a pseudonym from any text; only graph names and statements name a topic.
        for text in ["/x;touch${IFS}y", "/odom\nverified", "", "odom", "authros/", "authros/a\tb"] {
            refused(read(id(text), vec![], text, kind), "topic");
        }
        assert!(read(id("authros/recorder"), vec![], "authros/recorder", kind).is_ok());
    }
}
