//! The operators' socket: made where nobody else can put another one, and made again where that was not possible.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::UnixListener;
use tokio::task::block_in_place;

use crate::crypto::hands::{self, Fault};
use crate::paths::Home;
use crate::service::accounts;
use crate::service::event::NoticeLevel;
use crate::service::socket;
use crate::site::Site;

/// Interval between attempts to listen.
const AGAIN: Duration = Duration::from_secs(5);
/// The group of the socket may connect: what a user may do there, the settings say.
const MODE: u32 = 0o660;

impl Site {
    /// Serves operators until the site ends.
    pub(in crate::site) async fn serve_operators(self: Arc<Self>) {
        let settings = &self.config().operators;
        let Some(path) = &settings.socket else { return };
        for line in block_in_place(|| accounts::unknown(&settings.rules)).unwrap_or_default() {
            self.parts.hub.notice(NoticeLevel::Warning, &line);
        }
        let mut told = None;
        while !self.parts.life.is_stopping() {
            match block_in_place(|| listen(self.home(), path)) {
                Ok(listener) => return socket::accept_operators(&self, &listener).await,
                Err(why) => {
                    if told.as_ref() != Some(&why) {
                        let text = format!("operators cannot connect to {}: {why}", path.display());
                        self.parts.hub.notice(NoticeLevel::Error, &text);
                        told = Some(why);
                    }
                }
            }
            tokio::select! {
                () = tokio::time::sleep(AGAIN) => {}
                () = self.stopped() => return,
            }
        }
    }
}

fn listen(home: &Home, path: &Path) -> Result<UnixListener, String> {
    let unusable = |error: std::io::Error| format!("{error}; make its folder, or choose another operators.socket");
    let folder = path.parent().unwrap_or(path).canonicalize().map_err(unusable)?;
    if home.root().canonicalize().is_ok_and(|home| folder.starts_with(home)) {
        return Err("it is in the home, which only its owner may enter; choose another operators.socket".to_owned());
    }
    match hands::fault(&folder, rustix::process::geteuid().as_raw()).map_err(unusable)? {
        None => socket::bind(path, MODE).map_err(unusable),
        Some(Fault::Foreign(folder)) => {
            Err(format!("{} belongs to another user; choose a folder of the site's user", folder.display()))
        }
        Some(Fault::Open(folder)) => Err(format!(
            "others can write to {} and could put another socket there; run chmod go-w on it",
            folder.display()
        )),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[tokio::test]
    async fn a_socket_is_made_where_nobody_else_can_replace_it_and_outside_the_home() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().join("home"));
        std::fs::create_dir(home.root()).expect("a home");
        let place = folder.path().join("run");
        std::fs::create_dir(&place).expect("a folder");
        let path = place.join("operators.sock");
        let listener = listen(&home, &path).expect("listens");
        let mode = std::fs::metadata(&path).expect("a socket").permissions().mode() & 0o777;
        assert_eq!(mode, MODE);
        assert!(listen(&home, &path).expect_err("somebody answers there").contains("in use"));
        drop(listener);
        drop(listen(&home, &path).expect("one that nobody answers is replaced"));
        for mode in [0o770, 0o702, 0o1777] {
            set_permissions(&place, Permissions::from_mode(mode)).expect("its mode");
            assert!(listen(&home, &path).expect_err("others write it").contains("chmod go-w"), "{mode:o}");
        }
        let inside = home.root().join("operators.sock");
        assert!(listen(&home, &inside).expect_err("in the home").contains("in the home"));
        assert!(listen(&home, &folder.path().join("missing/operators.sock")).is_err());
    }
}
