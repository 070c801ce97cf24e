//! What gateways of one fleet ask each other, and what an owner tells the gateways that her home joins.

use super::Client;
use crate::gateway::command::{
    Answer, ErasureOutcome, ErasurePlace, Erasures, HandedOver, HoldingPlace, Holdings, ManyHandedOver, Request,
    ToldErasure, Wanted,
};
use crate::gateway::error::GatewayError;

impl Client {
    /// What the gateway holds after a place in its holdings; its word, until the records have been fetched and checked.
    ///
    /// # Errors
    /// [`GatewayError`]; `Refused(NotAuthorised)` if its keeper has not named the caller's gateway.
    pub async fn holdings(&mut self, after: HoldingPlace) -> Result<Holdings, GatewayError> {
        match self.ask(&Request::Holdings(after)).await? {
            Answer::Holdings(holdings) => Ok(*holdings),
            _ => Err(GatewayError::Unexpected("no holdings")),
        }
    }

    /// What was erased at the gateway, after a place; nothing of it is checked here.
    ///
    /// # Errors
    /// [`GatewayError`]; `Refused(Malformed)` if it is a gateway of an earlier version, whose session goes on.
    pub async fn erasures(&mut self, after: ErasurePlace) -> Result<Erasures, GatewayError> {
        match self.ask(&Request::Erasures(after)).await? {
            Answer::Erasures(erasures) => Ok(*erasures),
            _ => Err(GatewayError::Unexpected("nothing of what was erased")),
        }
    }

    /// Records of a range. Nothing of them is checked here.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn hand_over(&mut self, wanted: Wanted) -> Result<HandedOver, GatewayError> {
        match self.ask(&Request::HandOver(wanted)).await? {
            Answer::HandedOver(handed) => Ok(*handed),
            _ => Err(GatewayError::Unexpected("no records of the range")),
        }
    }

    /// Records of several ranges: 2 to 64, of at most 8,192 numbers in all. Nothing of them is checked here.
    ///
    /// # Errors
    /// [`GatewayError`]; `Refused(Malformed)` if it is a gateway of an earlier version, whose session goes on.
    pub async fn hand_over_many(&mut self, wanted: Vec<Wanted>) -> Result<ManyHandedOver, GatewayError> {
        match self.ask(&Request::HandOverMany(wanted)).await? {
            Answer::ManyHandedOver(many) => Ok(*many),
            _ => Err(GatewayError::Unexpected("no records of the ranges")),
        }
    }

    /// Tells what the session's owner had erased, at most 64 records; returns what becomes of each at the gateway, by its word.
    ///
    /// # Errors
    /// [`GatewayError`]; `Refused(Malformed)` if it is a gateway of an earlier version, whose session goes on.
    pub async fn tell_erasures(&mut self, told: Vec<ToldErasure>) -> Result<Vec<ErasureOutcome>, GatewayError> {
        let count = told.len();
        match self.ask(&Request::TellErasures(told)).await? {
            Answer::ErasuresTaken(outcomes) if outcomes.len() == count => Ok(outcomes),
            _ => Err(GatewayError::Unexpected("nothing of what becomes of what was told")),
        }
    }
}
