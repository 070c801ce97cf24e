//! A name counts only under the pseudonym that is derived from it.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use super::tests::Sample;
use super::*;
use crate::model::ErrorKind;
use crate::{ProviderName, provider};

fn index() -> IndexKey {
    IndexKey::new([3; 32])
}

fn id(topic: &str) -> TopicId {
    topic_id(&index(), topic)
}

/// What a reader with IK says of a record under these pseudonyms whose head names a topic, a type, and mission=7.
fn read(topic_id: TopicId, filters: Vec<FilterId>, topic: &str, type_name: &str) -> Result<()> {
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
    let refused = |found: Result<()>, field: &str| {
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
