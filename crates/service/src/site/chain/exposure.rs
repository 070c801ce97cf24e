//! The chain for others: the contract deployed by command, and its JSON-RPC for other tools.

use super::connection::Connection;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::oneshot;

use crate::chain::{DEFAULT_DELAY, LONGEST_DELAY, SHORTEST_DELAY, serve};
use crate::model::ProfileName;
use crate::pipeline::Owner;
use crate::service::event::NoticeLevel;
use crate::service::failure::input;
use crate::service::reply::{DeployedView, Failure, ServedView};
use crate::site::NetworkState;

impl Connection {
    /// Deploys the contract with the owner's account and pins it.
    pub(in crate::site) async fn deploy_contract(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        delay: Option<u64>,
    ) -> Result<DeployedView, Failure> {
        let delay = delay.map_or(DEFAULT_DELAY, Duration::from_secs);
        if !(SHORTEST_DELAY..=LONGEST_DELAY).contains(&delay) {
            return Err(input("the succession delay must be between 1 and 365 days; give another --delay"));
        }
        self.link.chain().await?;
        if let NetworkState::Up(network) = &*self.link.state() {
            let contract = network.chain.pin().map_or_else(|| "a contract".to_owned(), |pin| pin.contract.to_string());
            return Err(input(format!(
                "{contract} is already pinned for this home, nothing was deployed; use another --home for another one"
            )));
        }
        let network = self.network_or_deploy_with(owner, delay).await?;
        let pin = network.chain.pin().ok_or_else(|| input("the chain has stopped; run the command again"))?;
        Ok(DeployedView { pin, administrator: owner.address })
    }

    /// Answers other tools until `ended`, or the site's end.
    pub(in crate::site) async fn serve_chain(
        self: &Arc<Self>,
        profile: &ProfileName,
        address: SocketAddr,
        ended: oneshot::Receiver<()>,
    ) -> Result<ServedView, Failure> {
        let chain = self.link.chain().await?;
        if self.config.chain_url.is_some() {
            return Err(input(format!("this site uses the node at {}; point other tools there", chain.url())));
        }
        let listener = serve::listen(address).await?;
        let (by, subject) = (profile.clone(), address.to_string());
        self.log.write(profile, "serve chain", &subject, "begun").await?;
        let address = listener.local_addr().map_err(|error| input(format!("no address to listen on: {error}")))?;
        let view = ServedView {
            url: format!("http://{address}"),
            chain_id: chain.chain_id(),
            contract: chain.pin().map(|pin| pin.contract),
        };
        self.hub.notice(NoticeLevel::Info, &format!("the chain is available to tools on this machine at {}", view.url));
        let connection = Arc::clone(self);
        tokio::spawn(async move {
            let stop = async {
                tokio::select! {
                    () = connection.life.stopped() => {}
                    // A dropped sender means the same.
                    _ = ended => {}
                }
            };
            let served = chain.serve(listener, stop).await.map_err(Failure::from);
            if let Err(failure) = connection.log.ended(&by, "serve chain", &subject, served).await {
                connection.hub.notice(NoticeLevel::Error, &failure.message);
            }
        });
        Ok(view)
    }
}
