//! The Keys screen.

use crate::app::{Feed, State};
use crate::screens::topics;
use crate::service::reply::{EpochView, IdentityView, KeysView};
use crate::ui::{Canvas, Rect, Role, below, draw_facts, facts::LABEL, facts::draw_fact, right_of, row};

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
    let locked = match topics::capture::captured(state) {
        Some(_) => "locked (u unlocks it); capture and anchoring continue",
        None => "locked (u unlocks it)",
    };
    let (keyring, keyring_role) = if identity.unlocked { ("unlocked", Role::Good) } else { (locked, Role::Warning) };
    let (chain, chain_role) =
        if identity.registered { ("registered", Role::Good) } else { ("not registered: R registers", Role::Warning) };
    let facts = [
        ("Profile", identity.profile.to_string(), Role::Body),
        ("Keyring", keyring.to_owned(), keyring_role),
        ("On chain", chain.to_owned(), chain_role),
        ("Address", address, Role::Accent),
    ];
    let taken = draw_facts(canvas, area, &facts);
    let hint = "y copies it for anyone who wants to share with you; b backs up";
    canvas.put(right_of(row(area, taken), LABEL), hint, Role::Dim);
    let rest = below(area, taken + 2);
    let failure = state.feeds.slot(Feed::Keys).failure.as_ref();
    let missing = match &state.keys {
        Some(keys) => return draw_epochs(canvas, rest, keys),
        None if !identity.unlocked => "Fingerprints and epochs come from the keyring: u unlocks it.",
        None => failure.map_or("Asking for the keys…", |failure| &failure.message),
    };
    canvas.put(rest, missing, Role::Dim);
}

fn draw_epochs(canvas: &mut Canvas, area: Rect, keys: &KeysView) {
    draw_fact(canvas, row(area, 0), "SM2 signing", &keys.signing_fingerprint, Role::Body);
    draw_fact(canvas, row(area, 1), "SM2 decrypt", &keys.envelope_fingerprint, Role::Body);
    let area = below(area, 3);
    let about = "  newest first; token = public commitment to each key";
    canvas.puts(area, &[("SM4 epochs", Role::Title), (about, Role::Dim)]);
    let mut epochs: Vec<&EpochView> = keys.epochs.iter().collect();
    epochs.sort_by_key(|epoch| std::cmp::Reverse(epoch.epoch));
    for (place, epoch) in (1u16..area.height).zip(epochs) {
        let now = if epoch.current { "in use" } else { "" };
        let number = format!("{:>6}  ", epoch.epoch);
        let token = format!("{}…  ", epoch.token.to_hex().chars().take(16).collect::<String>());
        canvas.puts(row(area, place), &[(&number, Role::Body), (&token, Role::Dim), (now, Role::Good)]);
    }
}
