//! The Keys screen: identity, fingerprints, epochs.

use ratatui::layout::Rect;

use super::canvas::{Canvas, below, right_of, row};
use super::theme::Role;
use crate::app::feed::Feed;
use crate::app::{State, leaving};
use crate::service::reply::{EpochView, IdentityView, KeysView};

/// Columns of the labels.
const LABEL: u16 = 12;

/// What a locked keyring can and cannot do, because watched topics are still captured.
const LOCKED: &str = "locked (u unlocks it)";
const LOCKED_AT_WORK: &str = "locked (u unlocks it); capture and anchoring continue";

/// Draws a label and its value.
pub fn line(canvas: &mut Canvas, area: Rect, label: &str, value: &str, role: Role) {
    canvas.put(Rect { width: LABEL.min(area.width), ..area }, label, Role::Dim);
    canvas.put(right_of(area, LABEL), value, role);
}

/// Draws the screen.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State) {
    canvas.put(area, "Keys", Role::Title);
    let area = below(area, 1);
    match &state.identity {
        None => drop(canvas.put(area, "The site is starting…", Role::Dim)),
        Some(identity) if !identity.exists => {
            let text = "This profile has no identity yet: n creates one.";
            canvas.put(area, text, Role::Body);
        }
        Some(identity) => draw_identity(canvas, area, state, identity),
    }
}

fn draw_identity(canvas: &mut Canvas, area: Rect, state: &State, identity: &IdentityView) {
    let address = identity.address.map(|address| address.to_string()).unwrap_or_default();
    let (keyring, keyring_role) =
        if identity.unlocked { ("unlocked", Role::Good) } else { (locked(state), Role::Warning) };
    let (chain, chain_role) =
        if identity.registered { ("registered", Role::Good) } else { ("not registered: R registers", Role::Warning) };
    line(canvas, row(area, 0), "Profile", identity.profile.as_str(), Role::Body);
    line(canvas, row(area, 1), "Keyring", keyring, keyring_role);
    line(canvas, row(area, 2), "On chain", chain, chain_role);
    line(canvas, row(area, 3), "Address", &address, Role::Accent);
    canvas.put(
        right_of(row(area, 4), LABEL),
        "y copies it for anyone who wants to share with you; b backs up",
        Role::Dim,
    );
    let rest = below(area, 6);
    if let Some(keys) = &state.keys {
        draw_keys(canvas, rest, keys);
    } else {
        let locked = "Fingerprints and epochs come from the keyring: u unlocks it.";
        if !identity.unlocked {
            canvas.put(rest, locked, Role::Dim);
            return;
        }
        let failure = state.feeds.slot(Feed::Keys).failure.as_ref();
        canvas.put(rest, failure.map_or("Asking for the keys…", |failure| &failure.message), Role::Dim);
    }
}

fn draw_keys(canvas: &mut Canvas, area: Rect, keys: &KeysView) {
    line(canvas, row(area, 0), "SM2 signing", &keys.signing_fingerprint, Role::Body);
    line(canvas, row(area, 1), "SM2 decrypt", &keys.envelope_fingerprint, Role::Body);
    let area = below(area, 3);
    canvas.puts(
        area,
        &[("SM4 epochs", Role::Title), ("  newest first; token = public commitment to each key", Role::Dim)],
    );
    let mut epochs: Vec<&EpochView> = keys.epochs.iter().collect();
    epochs.sort_by_key(|epoch| std::cmp::Reverse(epoch.epoch));
    for (place, epoch) in (1u16..area.height).zip(epochs) {
        let now = if epoch.current { "in use" } else { "" };
        let number = format!("{:>6}  ", epoch.epoch);
        let token = format!("{}…  ", epoch.token.to_hex().chars().take(16).collect::<String>());
        canvas.puts(row(area, place), &[(&number, Role::Body), (&token, Role::Dim), (now, Role::Good)]);
    }
}

/// What goes on is said only if it is known.
fn locked(state: &State) -> &'static str {
    if leaving::captured(state).is_some() { LOCKED_AT_WORK } else { LOCKED }
}
