//! Opened records for viewing: fields, readable form, files, and the path over a topic's records.

use std::collections::HashMap;
use std::ffi::OsStr;

use tokio::task::block_in_place;

use super::of_namespace;
use super::own::{reason_of, record_view};
use crate::command::{LONGEST_PATH, UploadQuery};
use crate::crypto::{GrantedKeys, OpenedRecord};
use crate::model::{Address, ErrorKind, RecordKind, RecordState, Scope, TopicId, clean, counted};
use crate::pipeline::columns::Compared;
use crate::pipeline::{Granted, Network, Opening, Owner, Reader, Shown, authority, importer, is_held, tag_choice};
use crate::reply::{CheckView, ContractAnswer, Failure, OpenedView, PathView, RecordPage, Result, input};
use crate::ros::Limits;
use crate::ros::message::Folders;
use crate::ros::readable::{self, Exported};
use crate::ros::recording::{Described, TYPE_HASH, TypeFacts};
use crate::site::{Reading, reading};
use crate::store::{FilterChoice, RecordQuery, RecordRow};

/// Longer messages are viewed only as files.
const WHOLE: usize = 4 << 20;

/// Bytes shown in hex.
const SHOWN: usize = 16 << 10;

/// Rows of fields in a view.
const MOST_FIELDS: usize = 5_000;

struct Opened {
    row: RecordRow,
    record: OpenedRecord,
    reason: Option<String>,
    described: Described,
}

impl Reading {
    pub async fn open_record(&self, owner: &Owner, id: &str) -> Result<OpenedView> {
        let opened = self.opened(owner, id, "decrypt").await?;
        Ok(block_in_place(|| {
            let mut view = view_of(&opened, owner);
            if opened.record.body.len() <= WHOLE {
                view.picture = own_picture(&opened);
                view.body = Some(opened.record.body);
            }
            view
        }))
    }

    pub async fn file_of(&self, owner: &Owner, id: &str, kind: Option<Exported>) -> Result<OpenedView> {
        let opened = self.opened(owner, id, "export message").await?;
        block_in_place(|| {
            let mut view = view_of(&opened, owner);
            if opened.row.kind == RecordKind::Attachment {
                view.file = Some(attached(kind, &opened, &view)?);
                return Ok(view);
            }
            view.file = Some(match (kind, &opened.described.definition) {
                (Some(Exported::Bin), _) => opened.record.body,
                (None, _) => own_picture(&opened).unwrap_or(opened.record.body),
                (Some(kind), Some(definition)) => readable::export(kind, definition, &opened.record.body)
                    .map_err(|error| Failure::new(error.kind(), error.to_string()))?,
                (Some(_), None) => return Err(without_definition(&opened.row, &opened.described)),
            });
            Ok(view)
        })
    }

    async fn opened(&self, owner: &Owner, id: &str, deed: &str) -> Result<Opened> {
        let (row, network) = self.authorised(owner, id).await?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        let opened = async {
            let record = reader.open(&row).await?;
            let described = self.described(&reader, &row, &record).await?;
            Ok((record, described))
        };
        let (record, described) = self.parts.log.deed(&owner.profile, deed, &row.id, opened).await?;
        let (row, reason) = (as_signed(row, &record), reason_of(record.verdict, &network));
        Ok(Opened { row, record, reason, described })
    }

    async fn described(&self, reader: &Reader<'_>, row: &RecordRow, record: &OpenedRecord) -> Result<Described> {
        if row.kind != RecordKind::Data {
            return Ok(Described::default());
        }
        let text = reader.definition_text(row, record, Opening::Anchored).await?;
        let (head, about) = (&record.head, importer::about(&record.head.tags));
        let (encoding, hash) = (importer::encoding(&head.tags), about.get(TYPE_HASH).map(|hash| &**hash));
        let facts = TypeFacts { name: &head.type_name, encoding, text: text.as_deref(), hash, md5sum: &head.md5sum };
        let folders = Folders::of_prefixes(OsStr::new(&self.parts.config.definitions));
        let mut described = block_in_place(|| Described::of(facts, &folders));
        if described.definition.as_ref().is_some_and(|definition| definition.is_ambiguous(&record.body)) {
            let ambiguity = "its wide texts fit in more than one form (middlewares differ), so values may be wrong";
            described.note = Some(described.note.map_or(ambiguity.into(), |note| format!("{note}; {ambiguity}")));
        }
        Ok(described)
    }

    pub async fn path_to(&self, owner: &Owner, id: &str, records: usize) -> Result<PathView> {
        let records = records.clamp(2, LONGEST_PATH);
        let (row, network) = self.authorised(owner, id).await?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        let subject = format!("{} and what came before it, up to {}", row.id, counted(records as u64, "record"));
        self.parts.log.deed(&owner.profile, "decrypt", &subject, self.path_of(&reader, row, records)).await
    }

    async fn path_of(&self, reader: &Reader<'_>, row: RecordRow, records: usize) -> Result<PathView> {
        let last = reader.open(&row).await?;
        let described = self.described(reader, &row, &last).await?;
        let definition = described.definition.clone().ok_or_else(|| without_definition(&row, &described))?;
        let here = readable::place(&definition, &last.body).ok_or_else(|| {
            let kind = clean(definition.type_name(), 120);
            Failure::new(ErrorKind::Usage, format!("messages of {kind} contain no position, so there is no path"))
        })?;
        let (mut places, mut unread) = (vec![here], 0);
        for earlier in self.before(&row, records - 1)? {
            let opened = if reader.authorise(&earlier).is_ok() { reader.open(&earlier).await.ok() } else { None };
            match opened.and_then(|opened| readable::place(&definition, &opened.body)) {
                Some(place) => places.push(place),
                None => unread += 1,
            }
        }
        places.reverse();
        let topic = clean(&row.topic, 255);
        let plot =
            readable::track(&format!("Path: last {}", counted(places.len() as u64, "record")), &places, Some(here));
        Ok(PathView { id: row.id, topic, records: places.len(), unread, plot })
    }

    /// Earlier messages of the record's stream, newest first.
    fn before(&self, row: &RecordRow, most: usize) -> Result<Vec<RecordRow>> {
        let query = RecordQuery {
            owner: Some(row.owner),
            topic_ids: Some(vec![row.topic_id]),
            kind: Some(RecordKind::Data),
            until: Some(row.captured_at),
            limit: most,
            newest_first: true,
            ..RecordQuery::default()
        };
        let mut page = self.parts.plant.ledger.records.list(&query)?;
        page.rows.retain(|earlier| earlier.state != RecordState::Dropped);
        Ok(page.rows)
    }
}

/// Shows the record's own names, even where a gateway's row has only pseudonyms.
fn as_signed(row: RecordRow, record: &OpenedRecord) -> RecordRow {
    let (header, head) = (&record.header, &record.head);
    RecordRow {
        seq: header.seq,
        epoch: header.epoch,
        kind: header.kind,
        captured_at: header.captured_at,
        topic: head.topic.clone(),
        type_name: head.type_name.clone(),
        bytes: head.plain_length,
        simulated: head.is_simulated(),
        ..row
    }
}

fn without_definition(row: &RecordRow, described: &Described) -> Failure {
    let why = described.note.as_deref().unwrap_or("it is not a message");
    input(format!("{} can only be written as .bin: {why}", row.id))
}

/// An attachment as a file: its description, or the attached file.
fn attached(kind: Option<Exported>, opened: &Opened, view: &OpenedView) -> Result<Vec<u8>> {
    if kind == Some(Exported::Json) {
        return Ok(serde_json::to_vec_pretty(&view.message).unwrap_or_default());
    }
    let content = reading::content(&opened.row.type_name, &opened.record.body).map(<[u8]>::to_vec);
    content.ok_or_else(|| {
        let id = &opened.row.id;
        input(format!("{id} is not an attachment as MCAP has them; write it as .json to see what is known"))
    })
}

fn own_picture(opened: &Opened) -> Option<Vec<u8>> {
    let picture = opened.described.definition.as_ref()?.compressed_image(&opened.record.body)?;
    let bytes = opened.record.body.get(picture.data).map(<[u8]>::to_vec);
    bytes.filter(|_| !crate::crypto::fault::is_off("restore"))
}

fn view_of(opened: &Opened, owner: &Owner) -> OpenedView {
    let (row, record, definition) = (&opened.row, &opened.record, opened.described.definition.as_ref());
    let decoded = definition.map(|definition| definition.decode(&record.body, Limits::default()));
    let (decoded, misfit) = match decoded.transpose() {
        Ok(decoded) => (decoded, None),
        Err(error) => (None, Some(error.to_string())),
    };
    let fields = decoded.as_ref().map(|value| value.flatten(MOST_FIELDS)).unwrap_or_default();
    let stated = reading::view(row.kind, &row.type_name, &record.body);
    let fields = stated.as_ref().map_or(fields, reading::fields);
    let of_another = row.owner != owner.address;
    let shown = Shown { compared: Compared::Head, ..Shown::unread(row.clone()) };
    OpenedView {
        record: record_view(&shown, of_another),
        verdict: record.verdict,
        reason: opened.reason.clone(),
        caller_id: clean(&record.head.caller_id, 255),
        tags: record.head.tags.iter().map(|(key, value)| (clean(key, 64), clean(value, 200))).collect(),
        compression: record.head.compression.word().to_owned(),
        stored: record.header.body_length,
        note: misfit.or_else(|| opened.described.note.clone()),
        fields: fields
            .into_iter()
            .take(MOST_FIELDS)
            .map(|(path, text)| (clean(&path, 200), clean(&text, 400)))
            .collect(),
        message: stated.or_else(|| decoded.map(|value| value.to_json())).unwrap_or_default(),
        readable: definition.and_then(|definition| readable::read(definition, &record.body)),
        beginning: record.body.get(..SHOWN.min(record.body.len())).unwrap_or_default().to_vec(),
        body: None,
        picture: None,
        file: None,
    }
}

impl Reading {
    /// Records of all owners with an active grant to this profile, within each grant's scope.
    pub async fn list_shared(&self, owner: &Owner, query: UploadQuery) -> Result<RecordPage> {
        if query.incident.is_some() {
            return Err(input("incidents cover your own records: use `authros records list --incident NAME`"));
        }
        let network = self.parts.link.network().await?;
        let wanted = query.owner.as_ref().map(|owner| self.contacts.resolve(owner)).transpose()?;
        let mut grants = authority::shared_with(&network.directory, owner.address);
        grants.retain(|grant| wanted.is_none_or(|wanted| wanted == grant.terms.owner));
        let scopes = grants.iter().map(|grant| (grant.terms.owner, grant.terms.scope.clone()));
        let scopes: HashMap<Address, Scope> = scopes.collect();
        if scopes.is_empty() {
            return Ok(RecordPage { records: Vec::new(), next: None, arriving: None });
        }
        self.parts.log.asked(owner, "list shared", &query).await?;
        let filters = self.shared_tag_filters(&network, owner, &grants, &query.tags)?;
        let readable = self.readable_topics(&scopes)?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        for owner in scopes.keys() {
            self.name_asked(*owner, reader.index_of(*owner), query.topic.as_ref())?;
            self.learn_names(&reader, *owner).await?;
        }
        let query = RecordQuery {
            owners: Some(scopes.keys().copied().collect()),
            owner: None,
            topic_ids: Some(readable),
            filters: filters.clone(),
            ..of_namespace(query)?
        };
        self.readable(&reader, query, &filters)
    }

    /// The next page with a record that the reader's keys open; it may be short.
    fn readable(&self, reader: &Reader<'_>, mut query: RecordQuery, filters: &[FilterChoice]) -> Result<RecordPage> {
        loop {
            let mut page = self.parts.plant.ledger.records.list(&query)?;
            page.rows.retain(|row| !is_held(row) && reader.topic_key(row).is_ok());
            if !page.rows.is_empty() || page.next.is_none() {
                return self.page_of(page, reader, filters, true);
            }
            query.after = page.next;
        }
    }

    /// Filter ids of another owner's tags, from the IK that a grant of all topics carries.
    fn shared_tag_filters(
        &self,
        network: &Network,
        owner: &Owner,
        grants: &[Granted],
        tags: &[(String, String)],
    ) -> Result<Vec<FilterChoice>> {
        if tags.is_empty() {
            return Ok(Vec::new());
        }
        let [grant] = grants else {
            return Err(input("tags are searched among the records of one owner; give the owner as well"));
        };
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        match reader.open_envelope(grant, grant.terms.epoch)?.keys {
            GrantedKeys::All { ref index_key, .. } => {
                let topics = self.topics_of(grant.terms.owner)?;
                Ok(tags.iter().map(|(name, value)| tag_choice(index_key, name, value, &topics)).collect())
            }
            GrantedKeys::Topics { .. } => Err(input(
                "a grant of some topics does not include the key needed to search by tag; search by topic or type",
            )),
        }
    }

    pub fn readable_topics(&self, scopes: &HashMap<Address, Scope>) -> Result<Vec<TopicId>> {
        let mut ids = Vec::new();
        for (owner, scope) in scopes {
            match scope {
                Scope::Topics(topics) => ids.extend(topics.iter().copied()),
                Scope::All => {
                    let counts = self.parts.plant.ledger.counts.by_state(Some(*owner))?;
                    ids.extend(counts.topics.iter().filter_map(|topic| topic.topic_id));
                    ids.extend(counts.attachments);
                }
            }
        }
        Ok(ids)
    }

    /// A record that the owner may read now, and the chain that says so; counts a refusal. Own records need no chain,
    /// others' always do.
    pub async fn authorised(&self, owner: &Owner, id: &str) -> Result<(RecordRow, Network)> {
        let row = self.find_record(id)?;
        let is_own = row.owner == owner.address;
        let network = if is_own { self.network_or_kept().await? } else { self.parts.link.network().await? };
        let allowed = Reader { plant: &self.parts.plant, network: &network, reader: owner }.authorise(&row);
        self.parts.log.count_refusal(owner, &allowed);
        allowed?;
        Ok((row, network))
    }

    /// The paper's `Data_Check`: digest and signature, without any key; also asks the contract about the right to read.
    pub async fn check_record(&self, owner: &Owner, id: &str) -> Result<CheckView> {
        let (row, network) = self.authorised(owner, id).await?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        let checked = async {
            let (verdict, digest) = reader.check(&row).await?;
            let asked = authority::ask_contract(&self.parts.plant, &network, owner.address, row.owner, row.epoch);
            Ok((verdict, digest, asked.await?))
        };
        let (verdict, digest, answer) = self.parts.log.deed(&owner.profile, "check", &row.id, checked).await?;
        let contract = answer.map(|answer| ContractAnswer {
            reader: owner.address,
            owner: row.owner,
            authorised: answer.authorised,
            epoch: answer.epoch,
            count: answer.count,
            last: (answer.count > 0).then_some(answer.last),
        });
        let (reason, transaction, block) = (reason_of(verdict, &network), row.transaction, row.block);
        Ok(CheckView { id: row.id, verdict, reason, digest, transaction, block, contract })
    }
}
