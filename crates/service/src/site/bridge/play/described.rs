//! How a record is played, or why it is not.

use super::{Checked, Play};
use crate::crypto::OpenedRecord;
use crate::model::{Verdict, clean};
use crate::pipeline::importer;
use crate::pipeline::reader::{Opening, Reader};
use crate::ros::Advertised;
use crate::ros::recording::Encoding;
use crate::ros::recording::tags::CHANNEL;
use crate::ros::ros2::{LONGEST_MESSAGE, Offered, WRITER};
use crate::service::reply::Failure;
use crate::site::bridge::feed::Item;
use crate::site::bridge::offer::offer;
use crate::site::bridge::stage::source_of;
use crate::site::bridge::target::{Form, NO_MESSAGE};

impl Play<'_> {
    /// How a record is played, or why it is not.
    pub(super) async fn described(
        &mut self,
        item: &Item,
        record: OpenedRecord,
        latching: bool,
    ) -> Result<Result<Checked, String>, Failure> {
        if record.verdict != Verdict::Verified {
            return Ok(Err("not verified yet".to_owned()));
        }
        let encoding = importer::encoding(&record.head.tags);
        if let Some(why) = self.target.objection(encoding) {
            return Ok(Err(why.to_owned()));
        }
        let Some(topic) = self.names.played(&record.head.topic) else {
            return Ok(Err(format!("{} is not a valid graph name with this prefix", clean(&record.head.topic, 255))));
        };
        if self.clock.as_ref() == Some(&topic) {
            return Ok(Err(format!("--clock publishes the time as {topic} instead")));
        }
        let form = match encoding {
            Encoding::Ros1 => self.of_one(item, &record, topic, latching).await?,
            Encoding::Cdr { .. } => of_two(&record, topic),
            Encoding::Beside(_) => Err(NO_MESSAGE.to_owned()),
        };
        // Publishers of one node share its name; those of ROS 2 have ids of their own.
        let writer = record.head.tags.get(&format!("{CHANNEL}{WRITER}")).unwrap_or(&record.head.caller_id);
        let source = source_of(item.row.owner, writer);
        Ok(form.map(|form| Checked { record, form, source }))
    }

    async fn of_one(
        &mut self,
        item: &Item,
        record: &OpenedRecord,
        topic: String,
        latching: bool,
    ) -> Result<Result<Form, String>, Failure> {
        let reader = Reader { plant: &self.bridge.plant, network: &self.network, reader: self.owner };
        let Some(definition) = self.definitions.text(&reader, &item.row, record, Opening::Anchored).await? else {
            return Ok(Err("no readable record contains the definition of its type".to_owned()));
        };
        let (type_name, md5sum) = (record.head.type_name.clone(), record.head.md5sum.clone());
        Ok(Ok(Form::One(Advertised { topic, type_name, md5sum, definition: definition.to_string(), latching })))
    }
}

/// A message of ROS 2 needs no definition: its bytes are passed on under the name of its type.
fn of_two(record: &OpenedRecord, name: String) -> Result<Form, String> {
    let Some(([high, low, options @ ..], _)) = record.body.split_first_chunk::<4>() else {
        return Err("its message is shorter than the header of one".to_owned());
    };
    if record.body.len() > LONGEST_MESSAGE as usize {
        return Err(format!("its message is longer than the {} MiB that are published", LONGEST_MESSAGE >> 20));
    }
    if options != &[0, 0] {
        return Err("the header of its message has options, which cannot be published unchanged".to_owned());
    }
    let (type_name, encoding) = (record.head.type_name.clone(), u16::from_be_bytes([*high, *low]));
    Ok(Form::Two(Offered { name, type_name, encoding, offer: offer(&record.head.tags) }))
}
