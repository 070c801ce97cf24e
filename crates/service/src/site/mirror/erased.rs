//! Asking for what is left of records that the gateway lists and does not hand out.

use super::{Broken, Joined};
use crate::gateway::{Client, Code, Entry, GatewayError, Standing};
use crate::model::{Address, RecordKind};
use crate::pipeline::PipelineError;
use crate::pipeline::mirror::Mirror;
use crate::service::event::{NoticeLevel, Part};

impl Joined {
    /// Takes in what the owner states of a record that the gateway does not have: that it was erased.
    pub(super) async fn learn_erased(
        &self,
        client: &mut Client,
        mirror: &Mirror<'_>,
        source: Address,
        entry: &Entry,
    ) -> Result<(), Broken> {
        let anchored = matches!(entry.standing, Standing::Anchored | Standing::Verified);
        if !anchored || entry.kind != RecordKind::Data {
            return Ok(());
        }
        let erased = match client.fetch_erased(&entry.digest).await {
            Ok(erased) => erased,
            // Not erased, or a gateway of an earlier version, which says no more than that it has no such record.
            Err(GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered | Code::Malformed)) => {
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
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
