//! What a console remembers of its last run: screen, filters, orders, columns. Kept in a file, read at the next start.

use serde::{Deserialize, Serialize};

use super::choosing;
use super::form::Field;
use super::screen::Screen;
use super::screens::{gateway, grants, topics};
use super::state::State;
use super::table::Table;
use crate::service::NoticeLevel;

/// One table's filter and order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptTable {
    /// The text of the filter.
    pub filter: String,
    /// Which column sorts.
    pub sort: usize,
    /// Whether the order is reversed.
    #[serde(default)]
    pub reversed: bool,
    /// The columns chosen, in order; empty = the usual ones.
    #[serde(default)]
    pub columns: Vec<String>,
}

/// The remembered state.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kept {
    /// Title of the screen in view.
    pub screen: String,
    /// Tables of Topics, Uploads, Shared, Grants, Gateway, Log.
    pub tables: Vec<KeptTable>,
    /// The least urgent level of the log: 0 to 2.
    pub level: u8,
    /// Whether local times are shown beside UTC.
    pub local_time: bool,
}

fn keep(table: &Table) -> KeptTable {
    KeptTable {
        filter: table.filter.text().to_owned(),
        sort: table.sort,
        reversed: table.reversed,
        columns: table.columns.iter().map(|name| (*name).to_owned()).collect(),
    }
}

/// What the next run should know.
pub fn kept(state: &State) -> Kept {
    let tables = [
        &state.topics.table,
        &state.uploads.table,
        &state.shared.table,
        &state.grants.table,
        &state.gateway.table,
        &state.log.table,
    ];
    Kept {
        screen: state.screen.title().to_owned(),
        tables: tables.into_iter().map(keep).collect(),
        level: match state.log.least {
            NoticeLevel::Info => 0,
            NoticeLevel::Warning => 1,
            NoticeLevel::Error => 2,
        },
        local_time: state.local_time,
    }
}

/// Restores the state of the last run; what makes no sense here is left as it is.
pub fn recall(state: &mut State, kept: &Kept) {
    if let Some(screen) = Screen::ALL.into_iter().find(|screen| screen.title() == kept.screen) {
        state.screen = screen;
    }
    let tables = [
        (&mut state.topics.table, Screen::Topics, topics::SORTS.len()),
        (&mut state.uploads.table, Screen::Uploads, 2),
        (&mut state.shared.table, Screen::Shared, 2),
        (&mut state.grants.table, Screen::Grants, grants::SORTS.len()),
        (&mut state.gateway.table, Screen::Gateway, gateway::SORTS.len()),
        (&mut state.log.table, Screen::Log, 1),
    ];
    for ((table, screen, orders), kept) in tables.into_iter().zip(&kept.tables) {
        table.filter = Field::with(&kept.filter);
        table.reversed = kept.reversed;
        table.sort = if kept.sort < orders { kept.sort } else { 0 };
        let names = kept.columns.iter().map(String::as_str);
        table.columns = choosing::known(screen, names).unwrap_or_default();
    }
    state.log.least = match kept.level {
        1 => NoticeLevel::Warning,
        2 => NoticeLevel::Error,
        _ => NoticeLevel::Info,
    };
    state.local_time = kept.local_time;
}
