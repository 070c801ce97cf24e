//! Which gateways signed for a record that is not verified yet: a robot of several gateways asks each of them only for
//! what it has, and passes on to the next what stays without a proof.

use std::collections::BTreeMap;

use rusqlite::params;

use super::forwarding::shift;
use super::rows::{self, RecordRow};
use super::{Ledger, Session};
use crate::model::{Digest, RecordState, SignerId, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

/// A page of the records that a gateway signed for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PlacedPage {
    /// The records, in the order of this ledger.
    pub rows: Vec<RecordRow>,
    /// Where the next page begins; none if this is the last.
    pub next: Option<i64>,
}

/// A record without a proof for too long, and who signed for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OverduePlace {
    /// The record.
    pub digest: Digest,
    /// The gateways that signed for it, the latest receipt first.
    pub gateways: Vec<SignerId>,
}

impl Ledger {
    /// The submitted records that a gateway signed for, after a page whose `next` was this.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn placed_at(&self, gateway: SignerId, after: Option<i64>, limit: usize) -> Result<PlacedPage, StoreError> {
        let limit = limit.max(1);
        self.read(|connection| {
            let sql = format!(
                "SELECT {}, n FROM placed JOIN records ON n = record WHERE gateway = (SELECT key FROM gateways WHERE id = ?1)
                 AND record > ?2 AND state = ?3 ORDER BY record LIMIT ?4",
                rows::COLUMNS
            );
            let submitted = RecordState::Submitted.code();
            let most = i64::try_from(limit).unwrap_or(i64::MAX);
            let values = params![gateway.0, after.unwrap_or(0), submitted, most];
            let mut streams = connection.prepare_cached(&sql)?;
            let keys: Vec<i64> =
                streams.query_map(values, |row| row.get(0))?.collect::<Result<_, rusqlite::Error>>()?;
            let by_key = rows::keyed_streams(connection, keys)?;
            let found = streams.query_map(values, |row| Ok((rows::record(row, &by_key)?, row.get::<_, i64>(14)?)))?;
            let found: Vec<(RecordRow, i64)> = found.collect::<Result<_, _>>()?;
            let next = found.last().map(|(_, key)| *key).filter(|_| found.len() >= limit);
            Ok(PlacedPage { rows: found.into_iter().map(|(row, _)| row).collect(), next })
        })
    }

    /// Whether a gateway signed for a record that is not decided yet.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn is_placed_at(&self, gateway: SignerId) -> Result<bool, StoreError> {
        self.read(|connection| {
            let sql = "SELECT EXISTS (SELECT 1 FROM placed JOIN records ON n = record
                       WHERE gateway = (SELECT key FROM gateways WHERE id = ?1) AND state = ?2)";
            let values = params![gateway.0, RecordState::Submitted.code()];
            Ok(connection.prepare_cached(sql)?.query_row(values, |row| row.get(0))?)
        })
    }

    /// Submitted records whose latest receipt was taken before a time, and which this gateway has not signed for, in the
    /// order of this ledger.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn overdue(&self, before: Timestamp, lacking: SignerId, limit: usize) -> Result<Vec<OverduePlace>, StoreError> {
        let (before, limit) = (whole("time", before.0)?, i64::try_from(limit).unwrap_or(i64::MAX));
        self.read(|connection| {
            let mut late = connection.prepare_cached(
                "SELECT digest, placed.record FROM placed JOIN records ON n = record WHERE state = ?1
                 AND NOT EXISTS (SELECT 1 FROM placed AS own WHERE own.record = placed.record
                     AND own.gateway = (SELECT key FROM gateways WHERE id = ?3))
                 GROUP BY placed.record HAVING max(placed.at) < ?2 ORDER BY placed.record LIMIT ?4",
            )?;
            let mut holders = connection.prepare_cached(
                "SELECT id FROM placed JOIN gateways ON key = gateway WHERE record = ?1 ORDER BY at DESC, gateway",
            )?;
            let submitted = RecordState::Submitted.code();
            let found = late.query_map(params![submitted, before, lacking.0, limit], |row| {
                Ok((Digest(row.get(0)?), row.get::<_, i64>(1)?))
            })?;
            let mut overdue = Vec::new();
            for row in found {
                let (digest, record) = row?;
                let gateways = holders.query_map([record], |row| row.get(0).map(SignerId))?;
                overdue.push(OverduePlace { digest, gateways: gateways.collect::<Result<_, _>>()? });
            }
            Ok(overdue)
        })
    }

    /// A gateway says that it does not know these: what no other gateway signed for is stored again. Returns how many
    /// that are.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes.
    pub fn unplace(&self, gateway: SignerId, digests: &[Digest]) -> Result<u64, StoreError> {
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            let mut remove = session.connection.prepare_cached(
                "DELETE FROM placed WHERE record = (SELECT n FROM records WHERE digest = ?1)
                 AND gateway = (SELECT key FROM gateways WHERE id = ?2)",
            )?;
            let mut left = session.connection.prepare_cached(
                "SELECT EXISTS (SELECT 1 FROM placed WHERE record = (SELECT n FROM records WHERE digest = ?1))",
            )?;
            let mut alone = Vec::new();
            for digest in &digests {
                remove.execute(params![digest.0, gateway.0])?;
                if !left.query_row(params![digest.0], |row| row.get::<_, bool>(0))? {
                    alone.push(*digest);
                }
            }
            shift(session, &alone, RecordState::Submitted, RecordState::Stored)
        })
    }

    /// Submitted records of a ledger that did not say yet who signed for them are this gateway's, as of now.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn place_unplaced(&self, gateway: SignerId, now: Timestamp) -> Result<(), StoreError> {
        let now = whole("time", now.0)?;
        let unplaced = "SELECT record FROM receipted WHERE record NOT IN (SELECT record FROM placed)
                        AND record IN (SELECT n FROM records WHERE state = ?1)";
        let submitted = RecordState::Submitted.code();
        let any = self.read(|connection| {
            let sql = format!("SELECT EXISTS ({unplaced})");
            Ok(connection.prepare_cached(&sql)?.query_row([submitted], |row| row.get::<_, bool>(0))?)
        })?;
        if !any {
            return Ok(());
        }
        self.write(move |session| {
            let key = gateway_key(session, gateway)?;
            let sql = format!("INSERT INTO placed SELECT record, ?2, ?3 FROM ({unplaced})");
            session.connection.prepare_cached(&sql)?.execute(params![submitted, key, now])?;
            Ok(())
        })
    }

    /// How many records that are not verified yet each gateway signed for.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn placed_counts(&self) -> Result<BTreeMap<SignerId, u64>, StoreError> {
        self.read(|connection| {
            let mut statement = connection
                .prepare_cached("SELECT id, count(*) FROM placed JOIN gateways ON key = gateway GROUP BY gateway")?;
            let found = statement.query_map([], |row| Ok((SignerId(row.get(0)?), rows::unsigned(row, 1)?)))?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }
}

fn gateway_key(session: &Session<'_>, gateway: SignerId) -> Result<i64, StoreError> {
    let connection = session.connection;
    connection.prepare_cached("INSERT OR IGNORE INTO gateways (id) VALUES (?1)")?.execute(params![gateway.0])?;
    Ok(connection
        .prepare_cached("SELECT key FROM gateways WHERE id = ?1")?
        .query_row(params![gateway.0], |row| row.get(0))?)
}

/// A gateway signed for these; those that are submitted are noted.
pub(super) fn put(
    session: &Session<'_>,
    gateway: SignerId,
    at: Timestamp,
    digests: &[Digest],
) -> Result<(), StoreError> {
    let (key, at) = (gateway_key(session, gateway)?, whole("time", at.0)?);
    let mut insert = session.connection.prepare_cached(
        "INSERT INTO placed SELECT n, ?2, ?3 FROM records WHERE digest = ?1 AND state = ?4
         ON CONFLICT DO UPDATE SET at = excluded.at",
    )?;
    for digest in digests {
        insert.execute(params![digest.0, key, at, RecordState::Submitted.code()])?;
    }
    Ok(())
}

/// These are decided: nobody is asked about them any more.
pub(super) fn clear(session: &Session<'_>, digests: &[Digest]) -> Result<(), StoreError> {
    let mut remove = session
        .connection
        .prepare_cached("DELETE FROM placed WHERE record = (SELECT n FROM records WHERE digest = ?1)")?;
    for digest in digests {
        remove.execute(params![digest.0])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered as record;
    use super::*;
    use crate::model::Signature;
    use crate::store::KeptReceipt;

    const HERE: SignerId = SignerId([1; 32]);
    const THERE: SignerId = SignerId([2; 32]);

    fn digests(numbers: &[u8]) -> Vec<Digest> {
        numbers.iter().map(|number| Digest([*number; 32])).collect()
    }

    fn ledger(home: &tempfile::TempDir) -> Ledger {
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.append((1..=5).map(record).collect()).expect("acknowledged");
        ledger
    }

    fn accept(ledger: &Ledger, gateway: SignerId, at: u64, numbers: &[u8]) -> u64 {
        let receipt = KeptReceipt { time: Timestamp(7), digests: digests(numbers), signature: Signature([9; 64]) };
        ledger.accept(gateway, Timestamp(at), receipt).expect("accepted")
    }

    fn at(ledger: &Ledger, gateway: SignerId) -> Vec<u8> {
        let page = ledger.placed_at(gateway, None, 10).expect("reads");
        page.rows.iter().map(|row| row.digest.0[0]).collect()
    }

    #[test]
    fn each_gateway_is_asked_for_what_it_signed_for() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        assert!(!ledger.is_placed_at(HERE).expect("reads"), "it never signed");
        accept(&ledger, HERE, 10, &[1, 2, 3]);
        accept(&ledger, THERE, 20, &[3, 4]);
        assert_eq!((at(&ledger, HERE), at(&ledger, THERE)), (vec![1, 2, 3], vec![3, 4]));
        let first = ledger.placed_at(HERE, None, 2).expect("reads");
        let second = ledger.placed_at(HERE, first.next, 2).expect("reads");
        assert_eq!((first.rows.len(), second.rows.len(), second.next), (2, 1, None));
        ledger.settle_forwarded(&digests(&[2, 3]), RecordState::Verified).expect("settles");
        assert_eq!((at(&ledger, HERE), at(&ledger, THERE)), (vec![1], vec![4]), "whoever proved it");
        // Lost by one, still with another; lost by the only one.
        accept(&ledger, THERE, 30, &[1]);
        assert_eq!(ledger.unplace(HERE, &digests(&[1])), Ok(0));
        assert_eq!(ledger.unplace(THERE, &digests(&[1, 4])), Ok(2));
        assert!(!ledger.is_placed_at(THERE).expect("reads"));
        let stored = ledger.in_state(None, RecordState::Stored, 9).expect("rows");
        assert_eq!(stored.iter().map(|row| row.digest.0[0]).collect::<Vec<_>>(), [1, 4, 5], "sent again");
        accept(&ledger, THERE, 40, &[5]);
        assert!(ledger.is_placed_at(THERE).expect("reads"));
        // Damaged here: nobody is asked about it any more.
        ledger.advance(&digests(&[5]), RecordState::Submitted, RecordState::Tampered).expect("moves");
        assert!(!ledger.is_placed_at(THERE).expect("reads"));
    }

    #[test]
    fn what_stays_without_a_proof_is_overdue_for_each_gateway_that_lacks_it() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        accept(&ledger, HERE, 10, &[1, 2]);
        accept(&ledger, HERE, 50, &[3]);
        let overdue = |before| ledger.overdue(Timestamp(before), THERE, 9).expect("reads");
        assert!(overdue(10).is_empty(), "not yet");
        let one = |number: u8, gateways: &[SignerId]| OverduePlace {
            digest: Digest([number; 32]),
            gateways: gateways.to_vec(),
        };
        assert_eq!(overdue(11), [one(1, &[HERE]), one(2, &[HERE])]);
        accept(&ledger, THERE, 20, &[1]);
        assert_eq!(overdue(60), [one(2, &[HERE]), one(3, &[HERE])], "both have the first");
        let third = SignerId([3; 32]);
        let lacking = |gateway, most| ledger.overdue(Timestamp(60), gateway, most);
        assert_eq!(lacking(third, 1), Ok(vec![one(1, &[THERE, HERE])]), "the latest first");
        assert_eq!(lacking(third, 9).expect("reads").len(), 3);
        assert_eq!(lacking(HERE, 9), Ok(Vec::new()), "it has all of them");
        assert_eq!(lacking(THERE, 1), Ok(vec![one(2, &[HERE])]), "what it has stands in nobody's way");
        assert_eq!(ledger.placed_counts().expect("reads"), [(HERE, 3), (THERE, 1)].into());
    }

    #[test]
    fn receipts_of_an_earlier_version_are_the_first_gateways() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        accept(&ledger, THERE, 10, &[1, 2]);
        ledger.write(|session| Ok(session.connection.execute("DELETE FROM placed", [])?)).expect("as it was");
        accept(&ledger, THERE, 10, &[3]);
        ledger.place_unplaced(HERE, Timestamp(40)).expect("places");
        ledger.place_unplaced(HERE, Timestamp(41)).expect("nothing more");
        assert_eq!((at(&ledger, HERE), at(&ledger, THERE)), (vec![1, 2], vec![3]));
    }
}
