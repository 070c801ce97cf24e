//! Who can read these topics now.

use crate::app::{Feed, State};
use crate::model::counted;
use crate::screens::grants;
use crate::screens::grants::state::{end, is_active, is_given, scope};
use crate::service::reply::GrantRow;
use crate::ui::{Canvas, Piece, Rect, Role, draw_lines};

/// No topic = all of them.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, topics: &[String]) {
    let mut lines: Vec<Piece> = Vec::new();
    if topics.is_empty() {
        let readers = grants::keys::readers(state, "New records of all topics:", None);
        lines.extend(readers.into_iter().map(|line| (line, Role::Body)));
    }
    let given: Vec<&GrantRow> = state.grants.rows.iter().filter(|row| is_given(row) && is_active(row)).collect();
    for topic in topics.iter().take(8) {
        lines.push((topic.clone(), Role::Accent));
        lines.push(("  you, while your keyring is unlocked".to_owned(), Role::Body));
        let may = given.iter().filter(|row| row.topics.is_empty() || row.topics.contains(topic));
        lines.extend(may.map(|row| (reader(row), Role::Body)));
    }
    if topics.len() > 8 {
        lines.push((format!("and {}", counted((topics.len() - 8) as u64, "more topic")), Role::Dim));
    }
    if !topics.is_empty() && state.awaits(Feed::Grants) {
        lines.push(("(the list of grants has not arrived yet)".to_owned(), Role::Warning));
    }
    let text = "Revoking does not undo reads: anyone who read a record may have kept it.";
    lines.extend([Piece::default(), (text.to_owned(), Role::Dim)]);
    draw_lines(canvas, area, "Who can read this now?", &lines, 0);
}

fn reader(row: &GrantRow) -> String {
    let name = row.name.as_deref().map_or_else(|| row.grantee.to_string(), |name| format!("{name} {}", row.grantee));
    format!("  {name}, {}, {}", scope(&row.topics), end(row.expires))
}
