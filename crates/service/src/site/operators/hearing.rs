//! What another process hears of a site's events, through its connection. The standing of an operator is looked at again
//! on each change of the statements and each second: nobody who was removed, or whose time is over, hears on.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::broadcast::error::RecvError;

use super::asker::Acting;
use super::{Asker, Operators};
use crate::model::OperatorRight;
use crate::service::command::Needed;
use crate::service::event::Event;
use crate::service::failure::refused;
use crate::service::reply::Failure;
use crate::site::Site;
use crate::site::consoles::Claims;

/// Between two looks at an operator's standing: statements may end by their time, or be changed on the disk.
const LOOK: Duration = Duration::from_secs(1);

/// What is told through a connection.
pub(crate) enum Heard {
    /// Something happened.
    Event(Event),
    /// Nothing more is told, and why.
    Ended(Failure),
}

impl Site {
    /// Tells a connection what happens, until `tell` says that nobody listens or its operator may not hear it.
    pub(crate) async fn tell_events(self: Arc<Self>, claims: Claims, tell: impl Fn(Heard) -> bool + Send) {
        let (mut events, mut changes) = (self.events(), self.operators.changed.subscribe());
        let asker = &claims.asker;
        let mut is_judged = false;
        loop {
            let event = tokio::select! {
                biased;
                // The sender is the site's own: without it there is nothing to tell either.
                changed = changes.changed() => if changed.is_ok() { None } else { return },
                goes_on = self.parts.life.beat(LOOK), if is_judged => if goes_on { None } else { return },
                event = events.recv() => match event {
                    Ok(event) => Some(event),
                    Err(RecvError::Lagged(_)) => continue,
                    Err(RecvError::Closed) => return,
                },
            };
            match asker.acting() {
                // Between two looks the last one counts, or what a request found meanwhile.
                Some(acting) if event.is_none() || !is_judged || !asker.is_known() => {
                    if let Some(refusal) = self.operators.deaf(&acting, asker).await {
                        tell(Heard::Ended(refusal));
                        return;
                    }
                    is_judged = true;
                }
                Some(_) => {}
                // Where operators are required, nobody unknown hears what happens.
                None if self.config().operators_required && !asker.is_known() => continue,
                None => {}
            }
            if let Some(event) = event
                && !tell(Heard::Event(event))
            {
                return;
            }
        }
    }
}

impl Operators {
    /// Why an operator may not hear what happens; `None` if it may.
    async fn deaf(self: &Arc<Self>, acting: &Acting, asker: &Asker) -> Option<Failure> {
        let look = (&acting.profile, Needed::Right(OperatorRight::Look));
        match self.refusal(acting, asker, look).await {
            Ok(why) => why.map(refused),
            // What cannot be read says that nobody is an operator.
            Err(failure) => Some(failure),
        }
    }
}
