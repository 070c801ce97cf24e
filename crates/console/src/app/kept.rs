//! What a console remembers until the next start.

use serde::{Deserialize, Serialize};

use crate::app::{Field, Screen, State, Table};
use crate::popups::columns::state::known;
use crate::service::NoticeLevel;

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptTable {
    pub filter: String,
    pub sort: usize,
    #[serde(default)]
    pub reversed: bool,
    /// In order; empty = the usual ones.
    #[serde(default)]
    pub columns: Vec<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kept {
    pub screen: String,
    /// Topics, Records, Received, Grants, Gateway, Log.
    pub tables: Vec<KeptTable>,
    /// The least urgent level of the log: 0 to 2.
    pub level: u8,
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

pub fn kept(state: &State) -> Kept {
    Kept {
        screen: state.screen.title().to_owned(),
        tables: Screen::all().filter_map(|screen| state.table_of(screen)).map(keep).collect(),
        level: state.log.least as u8,
        local_time: state.local_time,
    }
}

/// Ignores what makes no sense here.
pub fn recall(state: &mut State, kept: &Kept) {
    if let Some(screen) = Screen::all().find(|screen| screen.title() == kept.screen) {
        state.screen = screen;
    }
    for (screen, kept) in Screen::all().filter(|screen| screen.has_table()).zip(&kept.tables) {
        let Some(table) = state.table_of_mut(screen) else { continue };
        table.filter = Field::with(&kept.filter);
        table.reversed = kept.reversed;
        table.sort = if kept.sort < screen.orders().len() { kept.sort } else { 0 };
        let names = kept.columns.iter().map(String::as_str);
        table.columns = known(screen, names).unwrap_or_default();
    }
    let levels = [NoticeLevel::Info, NoticeLevel::Warning, NoticeLevel::Error];
    state.log.least = levels.get(usize::from(kept.level)).copied().unwrap_or(NoticeLevel::Info);
    state.local_time = kept.local_time;
}
