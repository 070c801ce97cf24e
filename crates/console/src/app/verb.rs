//! The one list of what an operator can do: keymap, palette, help and bottom bar are made
//! from it, and tests speak in it.

mod list;

use super::administration::Act;
use super::key::Key;
use super::screen::Screen;
pub use list::VERBS;

/// Something an operator can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verb {
    /// To a screen.
    Go(Screen),
    /// To the next screen.
    NextScreen,
    /// To the previous screen.
    PreviousScreen,
    /// Cursor up.
    Up,
    /// Cursor down.
    Down,
    /// A page up.
    PageUp,
    /// A page down.
    PageDown,
    /// To the first row.
    First,
    /// To the last row.
    Last,
    /// Mark the row.
    Mark,
    /// Mark every row shown, or none.
    MarkAll,
    /// Type a filter.
    Filter,
    /// To the next row that matches the filter.
    NextMatch,
    /// To the previous one.
    PreviousMatch,
    /// Sort by the next column.
    Sort,
    /// Reverse the order.
    Reverse,
    /// Choose the columns of the list.
    Columns,
    /// Watch or unwatch the marked topics, or the selected one.
    Watch,
    /// Provenance of the record.
    Details,
    /// Check, decrypt and show the record.
    Open,
    /// Check the record against the chain.
    Check,
    /// Export the record's files for third parties to check.
    Export,
    /// Create an identity.
    CreateIdentity,
    /// Open the keyring.
    Unlock,
    /// Register the identity on the chain.
    Register,
    /// Load a key file.
    LoadKey,
    /// Write a key into a file.
    ExportKey,
    /// Begin a new epoch.
    Rotate,
    /// Share.
    Grant,
    /// Extend a grant.
    Extend,
    /// Stop sharing.
    Revoke,
    /// Publishers of the topic, pinned and suspect.
    Publishers,
    /// Accept the publishers being read now.
    Pin,
    /// No longer accept a publisher.
    Unpin,
    /// Release quarantined messages.
    Release,
    /// Delete quarantined messages.
    Discard,
    /// Who can read this now.
    Readers,
    /// The address book.
    Contacts,
    /// The robot under the cursor, in full.
    Inspect,
    /// Set a robot's policy, or clear it.
    SetPolicy,
    /// A new incident.
    Incident,
    /// The incidents.
    Incidents,
    /// Speak for another profile.
    Profile,
    /// Remove the tour's strip.
    EndTour,
    /// Browse what others share.
    Browse,
    /// Play what is shared into ROS, or end that.
    Play,
    /// A copy of the keyring.
    BackUp,
    /// Wipe the keys from memory.
    Lock,
    /// Running commands.
    Tasks,
    /// Undo the last act.
    Undo,
    /// Local times beside UTC.
    LocalTime,
    /// An act of the administrator, or of the account that sets up the chain.
    Administer(Act),
    /// Copy what the cursor is on.
    Copy,
    /// Write the same into a file.
    WriteFile,
    /// Copy the last act as a command line.
    CopyCommand,
    /// Show only more urgent lines of the log.
    Level,
    /// Show only lines of the log from one source.
    Source,
    /// The whole of a line of the log.
    Read,
    /// Freeze the view (capture continues).
    Freeze,
    /// The next period of the graphs.
    Period,
    /// A robot's topics in one row, or in a row each.
    Fold,
    /// The same for all robots.
    FoldAll,
    /// Every command by name.
    Palette,
    /// The meaning of the keys.
    Help,
    /// Dismiss the message.
    Dismiss,
    /// Choose a theme.
    ChooseTheme,
    /// ASCII characters only, or all.
    Ascii,
    /// The mouse for the console, or for the terminal's own selection.
    Mouse,
    /// Redraw.
    Redraw,
    /// Suspend, back to the shell.
    Suspend,
    /// Leave.
    Quit,
}

/// One entry of the list.
#[derive(Debug, PartialEq, Eq)]
pub struct Entry {
    /// The verb.
    pub verb: Verb,
    /// Its name in the palette.
    pub name: &'static str,
    /// The short word of the bottom bar; empty = not in the bar.
    pub label: &'static str,
    /// A line of help.
    pub help: &'static str,
    /// The preset keys.
    pub keys: &'static [Key],
    /// Preset keys that are pressed in sequence.
    pub chord: &'static [Key],
    /// The screens where the keys work; empty = all.
    pub on: &'static [Screen],
    /// Whether it changes keys, grants or records; hidden when read-only.
    pub changes: bool,
    /// Whether the palette lists it.
    pub palette: bool,
}

const fn entry(verb: Verb, name: &'static str, label: &'static str, keys: &'static [Key], help: &'static str) -> Entry {
    Entry { verb, name, label, help, keys, chord: &[], on: &[], changes: false, palette: true }
}

impl Entry {
    const fn on(mut self, screens: &'static [Screen]) -> Self {
        self.on = screens;
        self
    }

    const fn changing(mut self) -> Self {
        self.changes = true;
        self
    }

    const fn unlisted(mut self) -> Self {
        self.palette = false;
        self
    }

    const fn chord(mut self, chord: &'static [Key]) -> Self {
        self.chord = chord;
        self
    }

    /// All keys for it in the preset.
    pub fn chords(&self) -> impl Iterator<Item = Vec<Key>> {
        let chord = Some(self.chord.to_vec()).filter(|chord| !chord.is_empty());
        self.keys.iter().map(|key| vec![*key]).chain(chord)
    }

    /// Whether the preset's keys work on a screen.
    pub fn works_on(&self, screen: Screen) -> bool {
        self.on.is_empty() || self.on.contains(&screen)
    }
}

/// The entry of a verb, the one of this screen first.
pub fn entry_of(verb: Verb, screen: Screen) -> Option<&'static Entry> {
    let mut same = VERBS.iter().filter(|entry| entry.verb == verb);
    same.clone().find(|entry| entry.works_on(screen)).or_else(|| same.next())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_its_own() {
        for (index, entry) in VERBS.iter().enumerate() {
            assert!(VERBS[..index].iter().all(|other| other.name != entry.name), "{}", entry.name);
        }
    }
}
