//! What the pane beside a list shows.

use crate::app::screen::Screen;
use crate::model::Timestamp;
use crate::popups::{lookup::Lookup, record::state::Opening};
use crate::service::{Failure, reply::CoverageView, reply::Provenance};

#[derive(Debug, Default)]
pub struct Detail {
    pub about: Option<(Screen, String)>,
    pub due: Option<Timestamp>,
    pub steps: Option<Lookup<Provenance>>,
    pub opening: Option<Opening>,
    /// A topic, and when it has records.
    pub coverage: Option<(String, Result<Box<CoverageView>, Failure>)>,
}
