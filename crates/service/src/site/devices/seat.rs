//! A robot's place at its gateway: K_T for its name there, and the device that the name belongs to.

use std::time::Duration;

use super::enrolled::EnrolledGateway;
use crate::crypto::{GatewayAccess, TransportKey};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust};
use crate::model::{ProfileName, SignerId, Token};
use crate::pipeline::Owner;
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often the gateway is told of a device before the loan is on its chain.
const ATTEMPTS: u32 = 20;

/// A place at a gateway.
pub(super) struct Seat {
    endpoint: Endpoint,
    trust: Trust,
    gateway: SignerId,
    /// K_T.
    transport: TransportKey,
}

impl Seat {
    /// Allocates K_T for a name of the owner's, at the first address that answers.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn allocate(
        owner: &Owner,
        context: Context,
        (addresses, fingerprint): (Vec<String>, Option<SignerId>),
        name: &ProfileName,
    ) -> Result<Self, Failure> {
        let endpoint = Endpoint { addresses, context, patience: PATIENCE };
        let mut trust = fingerprint.map_or_else(Trust::on_first_use, Trust::pinned);
        let (signing, account) = (owner.signing(), owner.eoa());
        let applicant = Applicant { name, signing: &signing, envelope: owner.envelope().public, account: &account };
        let (transport, _) = Client::allocate(&endpoint, &mut trust, &applicant).await?;
        let gateway = trust.pinned.ok_or_else(|| refused("the gateway did not identify itself"))?;
        Ok(Self { endpoint, trust, gateway, transport })
    }

    /// A session under that name.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn connect(&mut self, name: &ProfileName, token: Token) -> Result<Client, Failure> {
        let credentials = Credentials { name: name.clone(), key: self.transport.clone(), token };
        Ok(Client::connect(&self.endpoint, &mut self.trust, &credentials).await?)
    }

    /// Tells the gateway whose the name is.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn tell(
        &mut self,
        owner: &Owner,
        (name, token): (&ProfileName, Token),
        notice: DeviceNotice,
    ) -> Result<(), Failure> {
        let mut client = self.connect(name, token).await?;
        for attempt in 1.. {
            match client.device(&owner.signing(), notice).await {
                // Its node may be behind ours.
                Err(GatewayError::Refused(Code::Signature | Code::NotRegistered | Code::Stale))
                    if attempt < ATTEMPTS =>
                {
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
                told => return Ok(told.map(|_| ())?),
            }
        }
        Ok(())
    }

    /// As the owner's ledger notes it.
    pub fn noted(&self) -> EnrolledGateway {
        EnrolledGateway { addresses: self.endpoint.addresses.clone(), key: self.gateway }
    }

    /// As the robot knows it.
    pub fn access(&self) -> GatewayAccess {
        let (addresses, fingerprint) = (self.endpoint.addresses.clone(), self.gateway);
        GatewayAccess { addresses, fingerprint, transport: self.transport.clone() }
    }
}
