//! A robot's place at one gateway: K_T for its name there, and the device that the name belongs to.

use std::time::Duration;

use super::enrolled::EnrolledGateway;
use super::enrolling::EnrolWishes;
use crate::crypto::{GatewayAccess, TransportKey};
use crate::gateway::{Applicant, Client, Code, Context, Credentials, DeviceNotice, Endpoint, GatewayError, Trust};
use crate::model::{ErrorKind, ProfileName, SignerId, Token};
use crate::pipeline::Owner;
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often the gateway is told of a device before the loan is on its chain.
const ATTEMPTS: u32 = 20;

/// A place at a gateway.
pub(super) struct Seat {
    pub endpoint: Endpoint,
    pub trust: Trust,
    pub gateway: SignerId,
    /// K_T; none while the gateway is away.
    pub transport: Option<TransportKey>,
}

impl Seat {
    /// Allocates K_T for a name of the owner's.
    ///
    /// # Errors
    /// Errors of the gateway.
    pub async fn allocate(
        owner: &Owner,
        context: Context,
        (address, fingerprint): (&str, Option<SignerId>),
        name: &ProfileName,
    ) -> Result<Self, Failure> {
        let endpoint = Endpoint { address: address.to_owned(), context, patience: PATIENCE };
        let mut trust = fingerprint.map_or_else(Trust::on_first_use, Trust::pinned);
        let (signing, account) = (owner.signing(), owner.eoa());
        let applicant = Applicant { name, signing: &signing, envelope: owner.envelope().public, account: &account };
        let (transport, _) = Client::allocate(&endpoint, &mut trust, &applicant).await?;
        let gateway = trust.pinned.ok_or_else(|| refused("the gateway did not identify itself"))?;
        Ok(Self { endpoint, trust, gateway, transport: Some(transport) })
    }

    /// Places at all requested gateways; of several, those that are away get theirs later, but one must be there.
    pub async fn allocate_all(owner: &Owner, context: Context, wishes: &EnrolWishes) -> Result<Vec<Self>, Failure> {
        let further = wishes.further.iter().map(|(address, key)| (address.as_str(), Some(*key)));
        let (mut seats, mut failed) = (Vec::new(), None);
        for (address, key) in [(wishes.gateway.as_str(), wishes.fingerprint)].into_iter().chain(further) {
            match (Self::allocate(owner, context, (address, key), &wishes.name).await, key) {
                (Ok(seat), _) => seats.push(seat),
                (Err(failure), Some(gateway)) if failure.kind == ErrorKind::Unreachable => {
                    let endpoint = Endpoint { address: address.to_owned(), context, patience: PATIENCE };
                    seats.push(Self { endpoint, trust: Trust::pinned(gateway), gateway, transport: None });
                    failed = failed.or(Some(failure));
                }
                (Err(failure), _) => return Err(failure),
            }
        }
        match failed {
            Some(failure) if seats.iter().all(|seat| seat.transport.is_none()) => Err(failure),
            _ => Ok(seats),
        }
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
        let key = self.transport.clone().ok_or_else(|| refused("no transport key was allocated"))?;
        let credentials = Credentials { name: name.clone(), key, token };
        let mut client = Client::connect(&self.endpoint, &mut self.trust, &credentials).await?;
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
        let address = self.endpoint.address.clone();
        EnrolledGateway { address, key: self.gateway, known: self.transport.is_some() }
    }

    /// As the robot knows it, if it has K_T.
    pub fn access(&self) -> Option<GatewayAccess> {
        let (address, fingerprint) = (self.endpoint.address.clone(), self.gateway);
        self.transport.clone().map(|transport| GatewayAccess { address, fingerprint, transport })
    }
}

/// Tells every gateway where there is a place; of several, one that went away meanwhile gets its place later.
pub(super) async fn tell_all(
    seats: &mut [Seat],
    owner: &Owner,
    by: (&ProfileName, Token),
    notice: DeviceNotice,
) -> Result<(), Failure> {
    let (mut told, mut failed) = (false, None);
    for seat in seats.iter_mut().filter(|seat| seat.transport.is_some()) {
        match seat.tell(owner, by, notice).await {
            Ok(()) => told = true,
            Err(failure) if failure.kind == ErrorKind::Unreachable => {
                seat.transport = None;
                failed = failed.or(Some(failure));
            }
            Err(failure) => return Err(failure),
        }
    }
    match failed {
        Some(failure) if !told => Err(failure),
        _ => Ok(()),
    }
}
