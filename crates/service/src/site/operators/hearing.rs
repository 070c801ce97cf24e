//! What another process hears of a site's events. The standing of an operator is looked at again each second, so that a
//! user whose right to look has ended hears no more, although that user asks nothing.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::broadcast::error::RecvError;

use super::Asker;
use crate::model::OperatorRight;
use crate::service::command::Needed;
use crate::service::event::Event;
use crate::service::reply::Failure;
use crate::site::Site;
use crate::site::consoles::Claims;

/// Interval between looks at an operator's standing.
const LOOK: Duration = Duration::from_secs(1);

/// What is sent through a connection.
pub(crate) enum Heard {
    /// Something happened.
    Event(Event),
    /// Nothing more is sent, and why.
    Ended(Failure),
}

impl Site {
    /// Sends events to a connection, until `tell` says that nobody listens or its operator may not hear them.
    pub(crate) async fn tell_events(self: Arc<Self>, claims: Claims, tell: impl Fn(Heard) -> bool + Send) {
        let mut events = self.events();
        loop {
            let event = tokio::select! {
                goes_on = self.parts.life.beat(LOOK), if matches!(claims.asker, Asker::Operator(_)) => {
                    if goes_on { None } else { return }
                }
                event = events.recv() => match event {
                    Ok(event) => Some(event),
                    Err(RecvError::Lagged(_)) => continue,
                    Err(RecvError::Closed) => return,
                },
            };
            if let Asker::Operator(operator) = &claims.asker
                && let Some(refusal) = self.operators.why_not(operator, Needed::Right(OperatorRight::Look)).await
            {
                tell(Heard::Ended(refusal));
                return;
            }
            if let Some(event) = event
                && !tell(Heard::Event(event))
            {
                return;
            }
        }
    }
}
