//! Records whose signers wrote false names into them: kept, since they are signed, but shown under none of these names.

use super::keeping::{elsewhere, head, sealed_elsewhere, taken};
use super::*;
use crate::crypto::{CryptoError, SealedRecord, filter_id};
use crate::model::{Address, ErrorKind, FilterId, Head};
use crate::pipeline::PipelineError;
use crate::pipeline::columns::{self, Comparison, Heads, Keys, Refusal, Shown, ShownState};
use crate::pipeline::intake::Accepted;
use crate::pipeline::reader::Reader;

const BODY: &[u8] = b"where it is";

impl Line {
    /// One whose owner has begun an epoch.
    async fn sealing() -> Self {
        let line = Self::new().await;
        line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
        line.owner.seal_under(line.network.domain, 1).expect("seals");
        line
    }

    /// A record in the pseudonym of `/robot1/odom`.
    fn filed(&self, seq: u64, filters: Vec<FilterId>, head: &Head) -> SealedRecord {
        sealed_elsewhere(&self.owner, seq, filters, (head, BODY), None)
    }

    /// As a gateway's desk takes it.
    fn receive(&self, sealed: &SealedRecord) {
        let row = NewRecord::foreign(sealed.clone(), Address([8; 20]));
        self.plant.keep([row], |row| self.plant.ledger.records.append(row.into())).expect("taken");
    }

    fn opener(&self) -> Reader<'_> {
        Reader { plant: &self.plant, network: &self.network, reader: &self.owner }
    }

    fn row(&self, sealed: &SealedRecord) -> RecordRow {
        self.plant.ledger.records.find(sealed.digest).expect("read").expect("there")
    }

    /// The row as it is shown to its owner.
    fn shown(&self, sealed: &SealedRecord) -> Shown {
        let (plant, keys) = (&self.plant, &self.opener());
        let comparison = Comparison { plant, keys, heads: &Heads::default(), filters: &[] };
        comparison.of(vec![self.row(sealed)]).expect("compared").remove(0)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_false_name_is_shown_nowhere_and_an_honest_record_beside_it_is() {
    let line = Line::sealing().await;
    let index = line.owner.index();
    let honest = elsewhere(&line.owner, 1, BODY, None);
    let topic = Head { topic: "/emergency_stop_released".to_owned(), ..head(BODY) };
    let kind = Head { type_name: "std_msgs/Bool".to_owned(), ..head(BODY) };
    // Longer than what is read first of a record.
    let long = Head { caller_id: "x".repeat(2 * columns::FRONT), ..topic.clone() };
    let of_type = vec![filter_id(&index, "type", &head(BODY).type_name)];
    let forged = [
        (line.filed(2, Vec::new(), &topic), "topic"),
        (line.filed(3, of_type, &kind), "type"),
        (line.filed(4, Vec::new(), &long), "topic"),
    ];
    [&honest].into_iter().chain(forged.iter().map(|(sealed, _)| sealed)).for_each(|sealed| line.receive(sealed));

    let shown = line.shown(&honest);
    assert_eq!((shown.row.topic.as_str(), shown.false_name, shown.differs), ("/robot1/odom", None, None));
    assert!(matches!(shown.state(), ShownState::Kept(_)) && line.opener().open(&line.row(&honest)).await.is_ok());
    for (sealed, what) in &forged {
        let shown = line.shown(sealed);
        assert_eq!((shown.state(), shown.false_name), (ShownState::Refused(Refusal::FalseName), Some(*what)));
        assert_eq!(shown.row.topic, RecordRow::unnamed(sealed.header.topic_id), "no name of it was learned");
        assert_eq!(ShownState::from_word(shown.state().word()), Some(shown.state()));
        let opened = line.opener().open(&line.row(sealed)).await.expect_err("refused");
        assert!(matches!(opened, PipelineError::Crypto(CryptoError::FalseName(found)) if found == *what), "{opened}");
        assert_eq!(opened.kind(), ErrorKind::Refused);
        assert!(line.opener().own_contents(&line.row(sealed)).expect("read").is_none());
        let front = &sealed.blob[..columns::FRONT.min(sealed.blob.len())];
        let opening = line.opener().opening(&sealed.header).expect("a key");
        assert_eq!(columns::false_name(&line.plant, &opening, sealed.digest, front), Some(*what));
    }
    let opening = line.opener().opening(&honest.header).expect("a key");
    assert_eq!(columns::false_name(&line.plant, &opening, honest.digest, &honest.blob), None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_mirror_names_the_record_that_it_does_not_take_for_its_name() {
    let line = Line::sealing().await;
    let forged = line.filed(1, Vec::new(), &Head { topic: "/other".to_owned(), ..head(BODY) });
    let digest = forged.digest;
    let Accepted::Refused(refused) = taken(&line, forged).await.expect("judged") else { panic!("taken in") };
    assert_eq!(refused.digest, digest, "{refused}");
    assert!(refused.to_string().contains("false topic"), "{refused}");
    assert!(line.plant.ledger.records.find(digest).expect("read").is_none());
    let honest = taken(&line, elsewhere(&line.owner, 1, BODY, None)).await.expect("judged");
    assert!(matches!(honest, Accepted::Held(true)), "{honest:?}");
}
