//! The Gateway screen: names with a transport key, connected or not.

use crate::app::fuzzy;
use crate::app::table::Table;
use crate::service::reply::{GatewayStatusView, SenderView};

/// The sort columns, in the order of `s`.
pub const SORTS: [&str; 3] = ["connected", "name", "frames"];

/// The gateway of this site.
#[derive(Debug, Default)]
pub struct Gateway {
    /// The site's report.
    pub view: Option<GatewayStatusView>,
    /// Cursor, filter, order.
    pub table: Table,
}

impl Gateway {
    /// Takes over the site's report.
    pub fn set(&mut self, view: GatewayStatusView) {
        self.view = Some(view);
        let keys = self.keys();
        self.table.settle(&keys);
    }

    /// The rows to show, filtered and in order.
    pub fn visible(&self) -> Vec<&SenderView> {
        let rows = self.view.iter().flat_map(|view| &view.senders).collect();
        let text = |row: &&SenderView| {
            let state = if row.sessions > 0 { "connected" } else { "away" };
            format!("{} {} {} {state}", row.name, row.account, row.peer.as_deref().unwrap_or(""))
        };
        let mut rows = fuzzy::narrow(self.table.filter.text(), rows, text);
        match self.table.sort {
            1 => rows.sort_by(|one, other| one.name.cmp(&other.name)),
            2 => rows.sort_by_key(|row| std::cmp::Reverse(row.frames)),
            _ => rows.sort_by_key(|row| row.sessions == 0),
        }
        if self.table.reversed {
            rows.reverse();
        }
        rows
    }

    /// The names of the rows shown.
    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|row| row.name.to_string()).collect()
    }
}
