//! Records passed on to a gateway, accepted by its receipt and decided by its statement.

use std::collections::BTreeSet;

use super::rows::{self, By, RecordRow, check, time};
use super::{Bindings, Forwarding, Names, Session};
use crate::StoreError;
use crate::database::{capped, whole};
use crate::model::bytes::hex;
use crate::model::{
    Address, Digest, ProfileName, PublicKey, RecordState, RecorderId, Signature, SignerId, Timestamp, TopicId,
};
use crate::sql::{Connection, params};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptReceipt {
    pub time: Timestamp,
    /// In order.
    pub digests: Vec<Digest>,
    /// By the gateway's identity key.
    pub signature: Signature,
}

/// Records with a receipt and no decision.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ForwardedPage {
    pub rows: Vec<RecordRow>,
    /// `None` on the last page.
    pub next: Option<i64>,
}

/// Moves records without a transaction or block of this ledger.
const MOVE: &str = "UPDATE records SET state = ?3 WHERE digest = ?1 AND state = ?2 AND tx IS NULL
    AND NOT EXISTS (SELECT 1 FROM leaves WHERE record = n)";

impl Forwarding {
    /// Stores the gateway's receipt; stored records become submitted. Returns how many.
    pub fn accept(&self, receipt: KeptReceipt) -> Result<u64, StoreError> {
        self.0.write(move |session| {
            let digests: Vec<u8> = receipt.digests.iter().flat_map(|digest| digest.0).collect();
            let sql = "INSERT INTO receipts (at, digests, signature) VALUES (?1, ?2, ?3)";
            let values = params![whole("time", receipt.time.0)?, digests, receipt.signature.0];
            let key = session.connection.inserted(sql, "key", values)?;
            let moved = shift(session, &receipt.digests, RecordState::Stored, RecordState::Submitted)?;
            let before = held(session, &receipt.digests)?;
            let sql = "INSERT INTO receipted SELECT n, ?2 FROM records WHERE digest = ?1
                ON CONFLICT (record) DO UPDATE SET receipt = excluded.receipt";
            session.connection.run_each(sql, receipt.digests.iter().map(|digest| (digest.0, key)))?;
            sweep(session, before)?;
            Ok(moved)
        })
    }

    /// Submitted records with a receipt, after a page's `next`.
    pub fn undecided(&self, after: Option<i64>, limit: usize) -> Result<ForwardedPage, StoreError> {
        let limit = limit.max(1);
        self.0.read(|connection| {
            let sql = format!(
                "SELECT {}, n FROM receipted CROSS JOIN records ON n = record WHERE record > ?1 AND state = ?2
                    ORDER BY record LIMIT ?3",
                rows::COLUMNS
            );
            let values = params![after.unwrap_or(0), RecordState::Submitted.code(), capped(limit)];
            let streams: Vec<i64> = connection.list(&sql, values, |row| row.get(0))?;
            let streams = rows::keyed_streams(connection, streams)?;
            let found: Vec<(RecordRow, i64)> =
                connection.list(&sql, values, |row| Ok((rows::record(row, &streams)?, row.get(14)?)))?;
            let next = found.last().map(|(_, key)| *key).filter(|_| found.len() >= limit);
            Ok(ForwardedPage { rows: found.into_iter().map(|(row, _)| row).collect(), next })
        })
    }

    /// Recorders of records that wait for forwarding or the gateway's decision.
    pub fn recorders(&self) -> Result<BTreeSet<RecorderId>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT DISTINCT r.id FROM counters c JOIN streams s ON s.key = c.stream
                     JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
                     WHERE c.state IN (?1, ?2) AND c.records > 0";
            let values = params![RecordState::Stored.code(), RecordState::Submitted.code()];
            Ok(connection.list(sql, values, |row| row.get(0).map(RecorderId))?)
        })
    }

    /// Applies the gateway's word: verified, tampered, or stored again if unknown there. Deletes receipts whose records
    /// are all verified. Returns how many changed.
    pub fn settle(&self, digests: &[Digest], to: RecordState) -> Result<u64, StoreError> {
        let from = RecordState::Submitted;
        check(By::Gateway, from, to)?;
        let digests = digests.to_vec();
        self.0.write_many(digests.len(), move |session| {
            let moved = shift(session, &digests, from, to)?;
            if to == RecordState::Verified {
                let before = held(session, &digests)?;
                let sql = "DELETE FROM receipted WHERE record = (SELECT n FROM records WHERE digest = ?1)";
                session.connection.run_each(sql, digests.iter().map(|digest| [digest.0]))?;
                sweep(session, before)?;
            }
            Ok(moved)
        })
    }

    /// The newest that covers an unverified record.
    pub fn receipt_of(&self, digest: Digest) -> Result<Option<KeptReceipt>, StoreError> {
        let sql = "SELECT at, digests, signature FROM receipts WHERE key = (SELECT receipt FROM receipted
                WHERE record = (SELECT n FROM records WHERE digest = ?1))";
        self.0.find(sql, [digest.0], |row| {
            let digests: Vec<u8> = row.get(1)?;
            let digests = digests.chunks(Digest::LENGTH).filter_map(Digest::from_slice).collect();
            Ok(KeptReceipt { time: time(row, 0)?, digests, signature: Signature(row.get(2)?) })
        })
    }
}

fn shift(session: &Session<'_>, digests: &[Digest], from: RecordState, to: RecordState) -> Result<u64, StoreError> {
    Ok(session.connection.run_each(MOVE, digests.iter().map(|digest| (digest.0, from.code(), to.code())))?)
}

fn held(session: &Session<'_>, digests: &[Digest]) -> Result<BTreeSet<i64>, StoreError> {
    let sql = "SELECT receipt FROM receipted WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let mut find = session.connection.prepared(sql)?;
    let found = digests.iter().map(|digest| find.find([digest.0], |row| row.get(0)));
    Ok(found.filter_map(Result::transpose).collect::<Result<_, _>>()?)
}

/// Deletes receipts that cover no record.
fn sweep(session: &Session<'_>, receipts: BTreeSet<i64>) -> Result<(), StoreError> {
    let sql = "DELETE FROM receipts WHERE key = ?1 AND NOT EXISTS (SELECT 1 FROM receipted WHERE receipt = ?1)";
    session.connection.run_each(sql, receipts.into_iter().map(|receipt| [receipt]))?;
    Ok(())
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptBinding {
    pub account: Address,
    /// P_C at the transport key's allocation.
    pub signing: PublicKey,
    /// P_E at that time.
    pub envelope: PublicKey,
    /// Sealed by its keeper.
    pub sealed_key: Vec<u8>,
    /// The device with the name, and the topic of notices to it; `None` = the account's own name.
    pub device: Option<(SignerId, TopicId)>,
}

/// A name with a transport key; `device` as in [`KeptBinding`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoundName {
    pub name: String,
    pub account: Address,
    pub device: Option<SignerId>,
}

impl Bindings {
    pub fn keep_signer(&self, id: SignerId, key: PublicKey) -> Result<(), StoreError> {
        // It comes with every record of the device: spares a commit each.
        if self.signer(id)?.is_some() {
            return Ok(());
        }
        self.0.write(move |session| add_signer(session.connection, id, key))
    }

    pub fn signer(&self, id: SignerId) -> Result<Option<PublicKey>, StoreError> {
        self.0.find("SELECT key FROM signers WHERE id = ?1", [id.0], |row| row.get(0).map(PublicKey))
    }

    /// `before`: the account that had the name; `false` if another one has it by now, and nothing is changed.
    pub fn bind(&self, name: &ProfileName, before: Option<Address>, binding: KeptBinding) -> Result<bool, StoreError> {
        let KeptBinding { account, signing, envelope, sealed_key, device } = binding;
        let (device, notices) = device.map(|(device, notices)| (device.0, notices.0)).unzip();
        let sql = "INSERT INTO bindings VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7) ON CONFLICT (name) DO UPDATE SET
            account = excluded.account, signing = excluded.signing, envelope = excluded.envelope,
            sealed_key = excluded.sealed_key, device = excluded.device, notices = excluded.notices
            WHERE bindings.account = ?8";
        let before = before.map(|account| account.0);
        let values = (name.to_string(), account.0, signing.0, envelope.0, sealed_key, device, notices, before);
        Ok(self.0.changed(sql, values)? > 0)
    }

    /// Does nothing if another key is bound meanwhile.
    pub fn reseal_binding(&self, name: &str, before: Vec<u8>, after: Vec<u8>) -> Result<(), StoreError> {
        let name = name.to_owned();
        let sql = "UPDATE bindings SET sealed_key = ?3 WHERE name = ?1 AND sealed_key = ?2";
        self.0.run(sql, (name, before, after))
    }

    /// Gives a name of `account` to a device, with the same transport key; `false` if there is no such name.
    pub fn bind_device(
        &self,
        name: &str,
        account: Address,
        device: SignerId,
        notices: TopicId,
    ) -> Result<bool, StoreError> {
        let name = name.to_owned();
        let sql = "UPDATE bindings SET device = ?3, notices = ?4 WHERE name = ?1 AND account = ?2";
        Ok(self.0.changed(sql, (name, account.0, device.0, notices.0))? > 0)
    }

    pub fn binding(&self, name: &ProfileName) -> Result<Option<KeptBinding>, StoreError> {
        let sql = "SELECT account, signing, envelope, sealed_key, device, notices FROM bindings WHERE name = ?1";
        self.0.find(sql, [name.as_str()], |row| {
            let device = match row.get::<Option<_>>(4)? {
                Some(device) => Some((SignerId(device), TopicId(row.get(5)?))),
                None => None,
            };
            let (account, signing, envelope) = (Address(row.get(0)?), PublicKey(row.get(1)?), PublicKey(row.get(2)?));
            Ok(KeptBinding { account, signing, envelope, sealed_key: row.get(3)?, device })
        })
    }

    /// Ordered by name.
    pub fn bound_names(&self) -> Result<Vec<BoundName>, StoreError> {
        let sql = "SELECT name, account, device FROM bindings ORDER BY name";
        self.0.list(sql, [], |row| {
            let device = row.get::<Option<_>>(2)?.map(SignerId);
            Ok(BoundName { name: row.get(0)?, account: Address(row.get(1)?), device })
        })
    }
}

impl Names {
    /// `id`: lower-case hex of a topic id or of a type's filter id, derived by the caller.
    pub fn keep(&self, owner: Address, id: String, name: String) -> Result<(), StoreError> {
        self.0.run("INSERT INTO names VALUES (?1, ?2, ?3) ON CONFLICT DO NOTHING", (owner.0, id, name))
    }

    /// Names a topic that is here without a name.
    pub fn keep_topic(&self, owner: Address, topic: TopicId, name: String) -> Result<(), StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM topics WHERE owner = ?1 AND topic_id = ?2 AND name = '')
                AND NOT EXISTS (SELECT 1 FROM names WHERE owner = ?1 AND id = lower(hex(?2)))";
        let is_here: bool = self.0.one(sql, params![owner.0, topic.0], |row| row.get(0))?;
        if is_here { self.keep(owner, hex(&topic.0), name) } else { Ok(()) }
    }

    /// Captured, learnt or given; none is proven.
    pub fn of_topic(&self, owner: Address, topic: TopicId) -> Result<Vec<String>, StoreError> {
        let sql = "SELECT name FROM topics WHERE owner = ?1 AND topic_id = ?2 AND name <> ''
            UNION SELECT name FROM names WHERE owner = ?1 AND id = lower(hex(?2))";
        self.0.list(sql, params![owner.0, topic.0], |row| row.get(0))
    }

    /// Up to `most` records of each stream whose topic or type is known only by its pseudonym.
    pub fn unnamed(&self, owner: Address, most: usize) -> Result<Vec<Vec<Digest>>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT s.key FROM streams s JOIN topics t ON t.key = s.topic
                WHERE t.owner = ?1 AND t.name = ''
                AND NOT EXISTS (SELECT 1 FROM names WHERE names.owner = ?1 AND id = lower(hex(t.topic_id))
                    AND (s.type_name = ''
                        OR EXISTS (SELECT 1 FROM names type WHERE type.owner = ?1 AND type.id = s.type_name)))";
            let streams: Vec<i64> = connection.list(sql, [owner.0], |row| row.get(0))?;
            let sql = "SELECT digest FROM counters c JOIN records r ON r.state = c.state AND r.stream = c.stream
                WHERE c.stream = ?1 AND c.records > 0 LIMIT ?2";
            let most = capped(most);
            let of = |stream: i64| Ok(connection.list(sql, [stream, most], |row| row.get(0).map(Digest))?);
            streams.into_iter().map(of).collect()
        })
    }
}

pub(super) fn add_signer(connection: &Connection, id: SignerId, key: PublicKey) -> Result<(), StoreError> {
    connection.run("INSERT INTO signers VALUES (?1, ?2) ON CONFLICT DO NOTHING", params![id.0, key.0])
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered as record;
    use super::*;
    use crate::Ledger;

    fn receipt(numbers: &[u8]) -> KeptReceipt {
        let digests = numbers.iter().map(|number| Digest([*number; 32])).collect();
        KeptReceipt { time: Timestamp(7), digests, signature: Signature([number_of(numbers); 64]) }
    }

    fn number_of(numbers: &[u8]) -> u8 {
        numbers.iter().sum()
    }

    #[test]
    fn a_receipt_moves_its_records_and_is_kept_until_all_are_verified() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.records.append((1..=4).map(record).collect()).expect("acknowledged");
        assert_eq!(ledger.forwarding.accept(receipt(&[1, 2, 9])), Ok(2), "one is not of this ledger");
        assert_eq!(ledger.forwarding.accept(receipt(&[2, 3])), Ok(1), "acknowledged again");
        let state = |number: u8| ledger.records.find(Digest([number; 32])).expect("reads").map(|row| row.state);
        assert_eq!(
            [1, 2, 3, 4].map(state),
            [RecordState::Submitted, RecordState::Submitted, RecordState::Submitted, RecordState::Stored].map(Some)
        );
        assert_eq!(ledger.forwarding.receipt_of(Digest([2; 32])), Ok(Some(receipt(&[2, 3]))), "the newest");
        assert_eq!(ledger.forwarding.settle(&[Digest([1; 32]), Digest([4; 32])], RecordState::Verified), Ok(1));
        assert_eq!(ledger.forwarding.receipt_of(Digest([1; 32])), Ok(None));
        assert_eq!(ledger.forwarding.settle(&[Digest([2; 32])], RecordState::Stored), Ok(1));
        assert_eq!(ledger.forwarding.receipt_of(Digest([2; 32])), Ok(Some(receipt(&[2, 3]))), "evidence");
        assert!(ledger.forwarding.settle(&[Digest([2; 32])], RecordState::Mined).is_err());
        assert_eq!(ledger.forwarding.accept(receipt(&[2])), Ok(1));
        assert_eq!(ledger.forwarding.settle(&[Digest([2; 32]), Digest([3; 32])], RecordState::Verified), Ok(2));
        let left: i64 = ledger
            .database
            .read(|connection| Ok(connection.one("SELECT count(*) FROM receipts", [], |row| row.get(0))?))
            .expect("reads");
        assert_eq!(left, 0);
    }

    #[test]
    fn what_is_signed_for_and_not_decided_is_listed_page_by_page() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.records.append((1..=5).map(record).collect()).expect("acknowledged");
        assert_eq!(ledger.forwarding.undecided(None, 9), Ok(ForwardedPage::default()));
        ledger.forwarding.accept(receipt(&[1, 2, 3, 4])).expect("accepted");
        let numbers = |page: &ForwardedPage| page.rows.iter().map(|row| row.digest.0[0]).collect::<Vec<_>>();
        let first = ledger.forwarding.undecided(None, 3).expect("reads");
        let second = ledger.forwarding.undecided(first.next, 3).expect("reads");
        assert_eq!((numbers(&first), numbers(&second), second.next), (vec![1, 2, 3], vec![4], None));
        ledger.forwarding.settle(&[Digest([2; 32])], RecordState::Verified).expect("settles");
        ledger.forwarding.settle(&[Digest([3; 32])], RecordState::Stored).expect("sent again");
        // Damaged here: nobody is asked about it any more.
        ledger.records.advance(&[Digest([4; 32])], RecordState::Submitted, RecordState::Tampered).expect("moves");
        assert_eq!(numbers(&ledger.forwarding.undecided(None, 9).expect("reads")), [1]);
    }
}
