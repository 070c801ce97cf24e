//! The gateway of a site (the paper's CR): takes frames over TCP, keeps what robots send, anchors it with the account
//! of the profile that runs it, and answers queries by the chain's grants at that moment.

mod desk;
mod live;
mod reading;
mod standing;

use std::net::SocketAddr;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::task::block_in_place;

use super::Site;
use super::operating::Serving;
use crate::crypto::{Fingerprint, SmKeyPair};
use crate::gateway::{Cabinet, Context, Limits, Schedule, Server};
use crate::model::{AnchorMode, Domain, Timestamp};
use crate::pipeline::Owner;
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, GatewayView};

/// How long requests under way may take when the gateway ends.
const FAREWELL: Duration = Duration::from_secs(3);

/// What a gateway does with commands; one profile of the site keeps it.
pub(super) struct GatewayDesk {
    site: Arc<Site>,
    /// Whose account anchors, and whose SM2 key is the gateway's identity.
    keeper: Arc<Owner>,
    /// The keeper's d_E, under which transport keys lie at rest: robots connect also while the keyring is locked.
    envelope: SmKeyPair,
    domain: Domain,
}

impl Site {
    /// Serves the gateway's protocol until `ended`, or the site's end.
    pub(super) async fn serve_gateway(
        self: &Arc<Self>,
        keeper: &Arc<Owner>,
        address: SocketAddr,
        ended: oneshot::Receiver<()>,
    ) -> Result<GatewayView, Failure> {
        if self.config.anchor_mode == AnchorMode::Each {
            return Err(input(
                "a gateway anchors records of many owners, which only batches can; set anchor.mode = 'batch'",
            ));
        }
        let network = self.network().await?;
        let registered = network.directory.identity(keeper.address)?;
        if registered.signing != keeper.signing().public {
            return Err(refused(format!(
                "the signing key of profile '{}' is not the one registered; run `authros register` first",
                keeper.profile
            )));
        }
        let server = self.listen(keeper, &network.domain, address).await?;
        let fingerprint = Fingerprint::of(&keeper.signing().public).to_string();
        let view = GatewayView {
            address: server.address().to_string(),
            gateway: server.id(),
            fingerprint,
            account: keeper.address,
            domain: network.domain,
        };
        self.record_audit(&keeper.profile, "gateway", &view.address, "serving").await?;
        self.hub.notice(NoticeLevel::Info, &format!("the gateway listens at {}", view.address));
        *self.served_gateway.lock().unwrap_or_else(PoisonError::into_inner) =
            Some(Serving { view: view.clone(), watch: server.watch() });
        self.changed(Part::Health);
        let site = Arc::clone(self);
        tokio::spawn(async move {
            tokio::select! {
                () = site.stopped() => {}
                // A dropped sender says the same.
                _ = ended => {}
            }
            *site.served_gateway.lock().unwrap_or_else(PoisonError::into_inner) = None;
            site.changed(Part::Health);
            server.stop(FAREWELL).await;
        });
        Ok(view)
    }

    async fn listen(
        self: &Arc<Self>,
        keeper: &Arc<Owner>,
        domain: &Domain,
        address: SocketAddr,
    ) -> Result<Server, Failure> {
        let provider = self.plant.provider;
        let cabinet = block_in_place(|| {
            let (directory, identity) = (self.home.gateway(), keeper.signing());
            Cabinet::open(&directory, provider, *domain, identity, Schedule::default(), Timestamp::now())
        })?;
        let desk = Arc::new(GatewayDesk {
            site: Arc::clone(self),
            keeper: Arc::clone(keeper),
            envelope: keeper.envelope(),
            domain: *domain,
        });
        let context = Context { provider, domain: *domain };
        Server::start(address, desk, context, cabinet, Limits::default())
            .await
            .map_err(|error| input(format!("the gateway cannot listen at {address}: {error}; choose another --listen")))
    }
}
