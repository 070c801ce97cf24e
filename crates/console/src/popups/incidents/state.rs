//! Incidents, and what can be done about one.

use crate::model::{IncidentName, Timestamp};
use crate::service::reply::IncidentView;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deed {
    Open,
    Note,
    Close,
    Remove,
}

impl Deed {
    pub fn words(self, name: &IncidentName) -> String {
        match self {
            Self::Open => format!("opening incident {name}"),
            Self::Note => format!("adding a note to incident {name}"),
            Self::Close => format!("closing incident {name}"),
            Self::Remove => format!("removing incident {name}"),
        }
    }

    /// Why it cannot be taken back; `None` = removing undoes it.
    pub fn stays(self) -> Option<&'static str> {
        match self {
            Self::Open => None,
            Self::Note => Some("a note cannot be removed from its incident"),
            Self::Close => Some("the span has ended; I opens another incident from there"),
            Self::Remove => Some("what it held may be deleted by now; I keeps what is left"),
        }
    }
}

#[derive(Debug, Clone, Default)]
pub struct Incidents {
    /// In the order of the site.
    pub rows: Vec<IncidentView>,
    /// When the site answered.
    pub told_at: Timestamp,
}

impl Incidents {
    pub fn set(&mut self, rows: Vec<IncidentView>, now: Timestamp) {
        (self.rows, self.told_at) = (rows, now);
    }

    pub fn put(&mut self, view: IncidentView) {
        match self.rows.iter_mut().find(|row| row.name == view.name) {
            Some(row) => *row = view,
            None => self.rows.push(view),
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct IncidentList {
    pub selected: usize,
    /// First line shown of the contents.
    pub scroll: usize,
}
