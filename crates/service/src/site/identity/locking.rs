//! Locking a profile, and a copy of its keys.

use super::Profiles;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use crate::model::ProfileName;
use crate::service::command::SecretBytes;
use crate::service::event::Part;
use crate::service::failure::{input, internal};
use crate::service::reply::{Failure, IdentityView};
use crate::site::blocking;

/// How long a running change may delay the locking.
const PATIENCE: Duration = Duration::from_secs(10);

impl Profiles {
    /// Wipes the keys for reading, granting and revoking. A running change of epochs or grants is waited for a moment:
    /// without its keys it could not be finished.
    pub(in crate::site) async fn lock(self: &Arc<Self>, profile: &ProfileName) -> Result<IdentityView, Failure> {
        let _not_opened = self.owners.opening(profile).await;
        if let Some(owner) = self.owners.get(profile).filter(|owner| !owner.is_locked()) {
            {
                // One that hangs is cut off: what it leaves open is resumed at the next unlock.
                let _one_at_a_time = tokio::time::timeout(PATIENCE, owner.changes.lock()).await.ok();
                if let Some(network) = self.link.network_now() {
                    block_in_place(|| self.sharing.foresee_locked(&owner, &network))?;
                }
                owner.lock(self.plant.provider)?;
                self.reading.forget();
            }
            self.hub.changed(Part::Identity);
            self.log.write(profile, "lock", "keyring", "done").await?;
        }
        self.view(profile).await
    }

    pub(in crate::site) async fn back_up_keys(self: &Arc<Self>, profile: &ProfileName) -> Result<SecretBytes, Failure> {
        let path = self.home.keyring(profile);
        if !path.exists() {
            return Err(input(format!("profile '{profile}' has no identity yet, so there is nothing to back up")));
        }
        let read = move |_: &Self| {
            std::fs::read(&path).map_err(|error| internal(format!("the keyring cannot be read: {error}")))
        };
        let bytes = self.log.deed(profile, "back up keys", "keyring", blocking(self, read)).await?;
        Ok(SecretBytes::new(bytes))
    }
}
