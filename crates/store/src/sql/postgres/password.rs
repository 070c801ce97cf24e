//! The password of a database whose URL has none, from where PostgreSQL's own programs have it: the variable PGPASSWORD, or the
//! file that PGPASSFILE names.

use std::path::Path;

use tokio_postgres::Config;
use tokio_postgres::config::Host;
use zeroize::Zeroizing;

use super::server::USUAL_PORT;
use crate::StoreError;
use crate::crypto::private_file::read_private;

const LONGEST: usize = 64 * 1024;

pub(super) fn of_environment(config: &Config) -> Result<Option<Zeroizing<String>>, StoreError> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(password) = set("PGPASSWORD") {
        return Ok(Some(Zeroizing::new(password.to_string_lossy().into_owned())));
    }
    let Some(file) = set("PGPASSFILE") else { return Ok(None) };
    let bytes = read_private(Path::new(&file), LONGEST).map_err(|error| StoreError::Password(error.to_string()))?;
    Ok(of_lines(&String::from_utf8_lossy(&bytes), config))
}

/// host:port:database:user:password, of the first line that fits; `*` fits all.
fn of_lines(text: &str, config: &Config) -> Option<Zeroizing<String>> {
    let user = config.get_user().unwrap_or_default();
    let database = config.get_dbname().unwrap_or(user);
    let (hosts, ports) = (config.get_hosts(), config.get_ports());
    let is = |field: &str, value: &str| field == "*" || field == value;
    let is_one_of = |field_host: &str, field_port: &str| {
        hosts.iter().enumerate().any(|(number, host)| {
            let port = ports.get(number).or(ports.first()).copied().unwrap_or(USUAL_PORT);
            let name = match host {
                Host::Tcp(name) => name.clone(),
                Host::Unix(_) => "localhost".to_owned(),
            };
            is(field_host, &name) && is(field_port, &port.to_string())
        })
    };
    text.lines().filter(|line| !line.starts_with('#')).find_map(|line| {
        let mut fields = fields(line);
        let password = Zeroizing::new(fields.pop().unwrap_or_default());
        let [host, port, of, by] = &fields[..] else { return None };
        (is_one_of(host, port) && is(of, database) && is(by, user)).then_some(password)
    })
}

/// A backslash stands before a colon or a backslash of a value.
fn fields(line: &str) -> Vec<String> {
    let (mut fields, mut chars) = (vec![String::new()], line.chars());
    while let Some(char) = chars.next() {
        match char {
            ':' if fields.len() < 5 => fields.push(String::new()),
            char => {
                let literal = if char == '\\' { chars.next().unwrap_or(char) } else { char };
                fields.last_mut().into_iter().for_each(|field| field.push(literal));
            }
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_that_of_the_first_line_that_fits() {
        // The form of PostgreSQL's manual, "The Password File".
        let text = "# comment\ndb9:*:*:*:no\ndb1:5433:fleet:authros:port\n*:*:other:authros:base\n\
                    db2:5432:fleet:authros:with\\:colon\\\\\n*:*:*:authros:last\n";
        let found = |url: &str| {
            let config: Config = url.parse().expect(url);
            of_lines(text, &config).map(|found| found.to_string())
        };
        assert_eq!(found("postgres://authros@db1:5433/fleet").as_deref(), Some("port"));
        assert_eq!(found("postgres://authros@db1,db2/fleet").as_deref(), Some("with:colon\\"));
        assert_eq!(found("postgres://authros@db1/other").as_deref(), Some("base"));
        assert_eq!(found("postgres://authros@db3/fleet").as_deref(), Some("last"));
        assert_eq!(found("postgres://somebody@db3/fleet"), None);
    }
}
