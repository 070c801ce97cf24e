//! What is left of records that the gateway lists and that their owner had erased.

use super::{Broken, Joined};
use crate::gateway::{Entry, ErasedRecord, Standing};
use crate::model::{Address, RecordKind};
use crate::pipeline::PipelineError;
use crate::pipeline::mirror::Mirror;
use crate::service::event::{NoticeLevel, Part};

impl Joined {
    /// Takes in what the owner states of a record.
    pub(super) async fn take_erased(
        &self,
        mirror: &Mirror<'_>,
        source: Address,
        entry: &Entry,
        erased: ErasedRecord,
    ) -> Result<(), Broken> {
        let anchored = matches!(entry.standing, Standing::Anchored | Standing::Verified);
        if !anchored || entry.kind != RecordKind::Data {
            return Ok(());
        }
        match mirror.take_erased(source, entry.digest, erased).await {
            Ok(true) => {
                self.hub.changed(Part::Grants);
                self.hub.changed(Part::Uploads);
                self.hub.confirmed.notify_one();
                Ok(())
            }
            Ok(false) => Ok(()),
            // One bad record must not keep the others away.
            Err(error @ (PipelineError::NotTakenIn { .. } | PipelineError::Crypto(_))) => {
                self.hub.notice(NoticeLevel::Error, &error.to_string());
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }
}
