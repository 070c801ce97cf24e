//! One valid message of every Command and shape.

use std::time::Duration;

use authros::crypto::{AccountSignature, ErasedStatement};
use authros::gateway::allocation::AllocationRequest;
use authros::gateway::command::{Inner, Part};
use authros::gateway::{
    Answer, Code, Command, DeviceNotice, ErasedRecord, ErasureNotice, ErasureOutcome, Feed, FeedEntry, FeedPage,
    Fetched, Found, GrantNotice, Notice, Place, Receipt, RelayCall, Request, RevokeNotice, Upload,
};
use authros::model::{
    Address, Digest, Fact, Hash, PublicKey, RecordKind, RecorderId, Signature, SignerId, Timestamp, Token, TopicId,
};

fn erasure() -> ErasureNotice {
    let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
    let record = Fetched { signer, signature, proof: vec![3; 10], blob: vec![4; 20] };
    let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
    let left = ErasedRecord { record, statement };
    ErasureNotice { digest: Digest([7; 32]), account_signature: AccountSignature([8; 65]), left }
}

fn feed() -> Feed {
    Feed {
        id: [1; 16],
        wait: Duration::from_millis(1_500),
        kind: Some(RecordKind::Key),
        topics: vec![TopicId([2; 16])],
        recorders: vec![RecorderId([3; 16])],
        places: vec![Place { owner: Address([4; 20]), after: 5, grant: 6 }],
    }
}

fn allocation() -> AllocationRequest {
    AllocationRequest {
        system_key: SignerId([1; 32]),
        ciphertext: vec![2; 30],
        signature: Signature([3; 64]),
        account_signature: AccountSignature([4; 65]),
    }
}

/// A client's request.
pub fn requests() -> Vec<Request> {
    let upload = |length| Upload { signature: Signature([7; 64]), blob: vec![8; length] };
    let (grantee, transaction) = (Address([5; 20]), Hash([6; 32]));
    vec![
        Request::Ping,
        Request::SystemKeys,
        Request::KeyAllocation(allocation()),
        Request::Upload(upload(30)),
        Request::UploadMany(vec![upload(0), upload(10), upload(20)]),
        Request::Feed(feed()),
        Request::Feed(Feed::of(Address([1; 20]))),
        Request::Records(true, vec![Digest([1; 32]), Digest([2; 32])]),
        Request::Records(false, vec![Digest([3; 32])]),
        Request::Notice(Notice::Grant(GrantNotice { grantee, epoch: 2, expiry: 3, transaction })),
        Request::Notice(Notice::Revoke(RevokeNotice { grantee, epoch: 2, token: Token([7; 32]), transaction })),
        Request::Notice(Notice::Device(DeviceNotice { key: PublicKey([6; 64]), notices: TopicId([7; 16]) })),
        Request::Relay(RelayCall { method: "eth_call".to_owned(), parameters: "[{},\"latest\"]".to_owned() }),
        Request::Erase(vec![erasure(); 2]),
    ]
}

fn page() -> FeedPage {
    let one = |number, fact, proof| FeedEntry {
        number,
        fact,
        digest: Digest([1; 32]),
        owner: Address([2; 20]),
        recorder: RecorderId([3; 16]),
        seq: 4,
        topic_id: TopicId([5; 16]),
        epoch: 6,
        captured_at: Timestamp(7),
        length: 8,
        kind: RecordKind::Gap,
        proof,
    };
    let entries = vec![one(3, Fact::Stored, Vec::new()), one(7, Fact::Verified, vec![3; 10])];
    FeedPage::new([9; 16], (12, 8), vec![(Address([8; 20]), Code::NotAuthorised)], entries)
}

/// The gateway's answer.
pub fn answers() -> Vec<Answer> {
    let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
    let record = Fetched { signer, signature, proof: vec![3; 10], blob: vec![4; 20] };
    let receipt = Receipt { time: Timestamp(9), digests: vec![Digest([1; 32])], signature: Signature([3; 64]) };
    vec![
        Answer::SystemKeys(vec![1; 30]),
        Answer::Receipt(Command::UploadMany, receipt),
        Answer::Feed(Box::new(page())),
        Answer::Records(vec![
            Found::Missing(Code::NotFound),
            Found::Here,
            Found::Held(record),
            Found::Erased(erasure().left),
        ]),
        Answer::Time(Timestamp(5)),
        Answer::Erasures(vec![ErasureOutcome::Taken, ErasureOutcome::Left, ErasureOutcome::Refused]),
        Answer::Refused(Code::Token),
    ]
}

/// The ND2 of a request.
pub fn client_text(request: &Request) -> Vec<u8> {
    let (command, body) = (request.command(), request.encode());
    let (token, signature) = (Some(Token([8; 32])), command.is_signed().then_some(Signature([9; 64])));
    Inner { command, part: Part::Whole, request: 7, token, signature, body: &body }.encode(false)
}

/// The ND2 of an answer.
pub fn gateway_text(answer: &Answer) -> Vec<u8> {
    let (command, body) = (answer.command(), answer.encode());
    Inner { command, part: Part::Whole, request: 7, token: None, signature: None, body: &body }.encode(true)
}
