//! The page: what it says, that no hostile text escapes from its place, that it is the same every time.

use std::collections::BTreeMap;

use authros_evidence::{BundledRecord, ClaimedChain, Disclosure, Packing, Report, verify};

use super::*;
use crate::crypto::record::RecordSecret;
use crate::crypto::{ProviderName, SealRequest, SmKeyPair, TopicKey, domain, provider, seal};
use crate::model::head::Compression;
use crate::model::{Address, Digest, Hash, Head, RecordKind, RecorderPrefix, Timestamp, TopicId};

const HOSTILE: &str = "</td></table><script>alert('x')</script>\"onload=&amp;\u{202e}";

/// A bundle with one disclosed record, all of whose texts are foreign.
fn told(type_name: &str, definition: &str, body: &[u8]) -> (Bundle, Report) {
    let provider = provider(ProviderName::default());
    let keys = SmKeyPair::generate(provider).expect("keys");
    let (owner, contract, genesis) = (Address([1; 20]), Address([2; 20]), Hash([3; 32]));
    let (bound, topic_key) = (domain(7, &genesis, &contract), TopicKey::new([4; 32]));
    let head = Head {
        topic: HOSTILE.into(),
        type_name: type_name.into(),
        md5sum: String::new(),
        definition: Digest(provider.sm3(&[definition.as_bytes()])),
        caller_id: HOSTILE.into(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::from([(HOSTILE.to_owned(), HOSTILE.to_owned())]),
    };
    let request = SealRequest {
        domain: bound,
        owner,
        signer: &keys,
        epoch: 1,
        topic_key: &topic_key,
        recorder: RecorderPrefix::ledger([5; 7]),
        seq: 1,
        topic_id: TopicId([6; 16]),
        kind: RecordKind::Data,
        filters: Vec::new(),
        captured_at: Timestamp::from_seconds(1_700_000_000),
        head: &head,
        body,
    };
    let sealed = seal(provider, &request).expect("seals");
    let secret = RecordSecret::of(&topic_key, &sealed.header);
    let secrets = BTreeMap::from([(sealed.digest, secret)]);
    let mut packing = Packing::default();
    packing.disclosure(&Disclosure::sign(secrets, &bound, &keys, provider).expect("signs"));
    let identity = crate::crypto::prove(
        provider,
        &bound,
        &owner,
        &keys,
        &SmKeyPair::generate(provider).expect("keys").public,
        crate::model::Token([7; 32]),
    );
    packing.identity(&identity.expect("proves"));
    packing.definition(definition, provider);
    let record = BundledRecord { record: sealed.blob.clone(), signature: sealed.signature, anchor: None };
    packing.record(sealed.digest, record).expect("added");
    let chain = ClaimedChain { id: 7, genesis, contract };
    let members = packing.sign(chain, owner, &keys, provider).expect("signs");
    let bundle = Bundle::of_members(&members, provider).expect("reads");
    let report = verify(&bundle, None, provider);
    (bundle, report)
}

/// A text message as ROS 1 sends it.
fn text(of: &str) -> Vec<u8> {
    [&u32::try_from(of.len()).expect("short").to_le_bytes()[..], of.as_bytes()].concat()
}

#[test]
fn what_strangers_wrote_stays_text() {
    let (bundle, report) = told("std_msgs/String", "string data", &text(HOSTILE));
    let page = page(&bundle, &report, None);
    assert_eq!(report.records.iter().filter(|record| record.disclosed.is_some()).count(), 1, "{report:?}");
    assert!(
        page.matches("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;").count() >= 4,
        "topic, node, tag, value: {page}"
    );
    for never in
        ["<script", "alert('x')", "\"onload", "\u{202e}", "http:", "https:", "url(", "@import", "<link", "<iframe"]
    {
        assert!(!page.contains(never), "{never} in {page}");
    }
    // Every opening tag is one of ours.
    let ours = [
        "!DOCTYPE", "html", "head", "meta", "title", "style", "body", "h1", "h2", "h3", "h4", "p", "b", "code",
        "table", "thead", "tr", "th", "td", "section", "ul", "li", "pre", "svg", "polyline", "circle", "img", "text",
        "rect",
    ];
    for opened in page.split('<').skip(1) {
        let name: String =
            opened.trim_start_matches('/').chars().take_while(|one| one.is_alphanumeric() || *one == '!').collect();
        assert!(ours.contains(&name.as_str()), "<{name}");
    }
}

#[test]
fn page_one_says_what_the_verdict_says_and_that_the_page_proves_nothing() {
    let (bundle, report) = told("std_msgs/String", "string data", &text("hello"));
    let shown = page(&bundle, &report, None);
    for part in [
        "This page proves nothing",
        "1 record claimed to be of 0x",
        "Readable: 1 record of &lt;/td&gt;&lt;/table&gt;&lt;script&gt;alert(",
        "default-src &#39;none&#39;".replace("&#39;", "'").as_str(),
        "hello",
        "openssl pkeyutl -verify",
        "2023-11-14T22:13:20",
        "(a)",
        "it was on no chain when the file was made",
        "data",
    ] {
        assert!(shown.contains(part), "no {part} in {shown}");
    }
    for sentence in &report.verdict {
        assert!(shown.contains(&escape(sentence)), "no {sentence} in {shown}");
    }
    assert_eq!(shown, page(&bundle, &report, None), "the same twice");
    let (bundle, report) = told("std_msgs/String", "no definition at all {", &text("hello"));
    assert!(page(&bundle, &report, None).contains("Its fields are not shown"));
}

#[test]
fn a_picture_is_within_the_page() {
    let definition = format!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n\
         uint8[] data\n{}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n",
        "=".repeat(80)
    );
    let mut body = [0u8; 12].to_vec();
    body.extend(text("camera"));
    body.extend([1u32.to_le_bytes(), 2u32.to_le_bytes()].concat());
    body.extend(text("rgb8"));
    body.push(0);
    body.extend([6u32.to_le_bytes(), 6u32.to_le_bytes()].concat());
    body.extend([255, 0, 0, 0, 0, 255]);
    let (bundle, report) = told("sensor_msgs/Image", &definition, &body);
    let page = page(&bundle, &report, None);
    assert!(page.contains("<img alt=\"the picture, reduced\" src=\"data:image/png;base64,iVBORw0KGgo"), "{page}");
}
