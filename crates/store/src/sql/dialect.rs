//! One text for both engines. SQLite reads the stores' statements as they are; for PostgreSQL three things change: `?1` is
//! `$1`, SQLite's hints about indices are left out, and its CROSS JOIN, a hint about order, is a plain join. Functions that
//! only SQLite has by these names are in postgres.sql.

/// What SQLite's planner is told.
const HINT: &str = "INDEXED BY ";
const NO_INDEX: &str = "NOT INDEXED";
const IN_ORDER: &str = "CROSS JOIN";

pub(super) fn for_postgres(sql: &str) -> String {
    let mut text = String::with_capacity(sql.len());
    let mut rest = sql;
    while let Some(first) = rest.chars().next() {
        let taken = match first {
            '\'' => {
                let length = rest.get(1..).and_then(|inner| inner.find('\'')).map_or(rest.len(), |end| end + 2);
                text.push_str(rest.get(..length).unwrap_or(rest));
                length
            }
            '?' => {
                text.push('$');
                1
            }
            'I' if rest.starts_with(HINT) => {
                let name = rest.get(HINT.len()..).unwrap_or_default();
                let is_part = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
                HINT.len() + name.find(|letter: char| !is_part(letter)).unwrap_or(name.len())
            }
            'N' if rest.starts_with(NO_INDEX) => NO_INDEX.len(),
            'C' if rest.starts_with(IN_ORDER) => {
                text.push_str("JOIN");
                IN_ORDER.len()
            }
            other => {
                text.push(other);
                other.len_utf8()
            }
        };
        rest = rest.get(taken..).unwrap_or_default();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_go_numbers_change_and_texts_stay() {
        for (sqlite, postgres) in [
            ("SELECT a FROM t WHERE b = ?1 AND c = ?12", "SELECT a FROM t WHERE b = $1 AND c = $12"),
            ("SELECT 'why?1' || ?1", "SELECT 'why?1' || $1"),
            ("UPDATE r INDEXED BY r_by_x SET y = ?1", "UPDATE r  SET y = $1"),
            ("FROM h INDEXED BY x_y CROSS JOIN r ON n = h", "FROM h  JOIN r ON n = h"),
            ("FROM r NOT INDEXED WHERE é = 'it''s ?2'", "FROM r  WHERE é = 'it''s ?2'"),
            ("SELECT 'open", "SELECT 'open"),
        ] {
            assert_eq!(for_postgres(sqlite), postgres);
        }
    }
}
