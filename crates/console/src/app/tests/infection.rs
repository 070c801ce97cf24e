//! Hostile names in place of all free text that a site sends. Which text is free is found by trying: what a reply still
//! reads with a hostile name in it can be sent by a stranger; a name of a robot, an account or an incident cannot.

use std::cell::RefCell;
use std::collections::HashMap;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use self::names::Hostile;
use crate::app::Action;
use crate::service::{Failure, Reply};

#[path = "../../../../../tests/support/hostile.rs"]
#[allow(dead_code, reason = "the flows use the rest")]
pub mod names;

/// What the site itself makes up, and by which the console asks again.
const TOKENS: [&str; 2] = ["id", "next"];

/// What no name with a form of its own can be.
const TRIAL: &str = "\u{1b}[2J\u{202e} x";

#[derive(Debug)]
struct Infection {
    names: Hostile,
    /// By place, without the indices of lists.
    free: HashMap<String, bool>,
}

thread_local! {
    static INFECTION: RefCell<Option<Infection>> = const { RefCell::new(None) };
}

/// Until `end`, all that this thread's consoles are told is hostile.
pub fn begin(seed: u64) {
    let infection = Infection { names: Hostile::new(seed), free: HashMap::new() };
    INFECTION.with_borrow_mut(|current| *current = Some(infection));
}

/// Returns how many names there were.
pub fn end() -> u64 {
    INFECTION.with_borrow_mut(Option::take).map_or(0, |infection| infection.names.names)
}

/// A name, while there is an infection.
pub fn name() -> Option<String> {
    INFECTION.with_borrow_mut(|current| Some(current.as_mut()?.names.name()))
}

pub fn infected(action: Action) -> Action {
    INFECTION.with_borrow_mut(|current| match (current, action) {
        (None, action) => action,
        (Some(infection), Action::Answered { tag, result }) => {
            let result = match *result {
                Ok(reply) => Ok(infection.reply(reply)),
                Err(failure) => Err(Failure::new(failure.kind, infection.names.name())),
            };
            Action::Answered { tag, result: Box::new(result) }
        }
        (Some(infection), Action::Told(event)) => Action::Told(infection.spread(event, "event", &|_| false)),
        (Some(infection), Action::FilesWritten(Err(_))) => Action::FilesWritten(Err(infection.names.name())),
        (Some(infection), Action::TextRead(path, Err(_))) => Action::TextRead(path, Err(infection.names.name())),
        (Some(_), action) => action,
    })
}

impl Infection {
    /// Topics of the graph keep their names: windows of a topic open for names of ROS alone.
    fn reply(&mut self, reply: Reply) -> Reply {
        let keeps: fn(&str) -> bool = match &reply {
            Reply::Topics(_) => |place| place == "/with/*/topic",
            _ => |_| false,
        };
        self.spread(reply, "reply", &keeps)
    }

    fn spread<T: Serialize + DeserializeOwned>(&mut self, value: T, kind: &str, keeps: &dyn Fn(&str) -> bool) -> T {
        let mut json = serde_json::to_value(&value).expect("JSON");
        let sort = json.get(kind).and_then(Value::as_str).unwrap_or_default().to_owned();
        let mut leaves = Vec::new();
        collect(&json, (String::new(), String::new()), &mut leaves);
        leaves.retain(|(_, place)| !keeps(place));
        for (pointer, place) in leaves {
            // What is missing stays so half of the time: it may have a picture of its own.
            let stays = json.pointer(&pointer).is_some_and(Value::is_null) && self.names.below(2) == 0;
            if !stays
                && self.is_free::<T>(&json, &pointer, format!("{sort} {place}"))
                && let Some(leaf) = json.pointer_mut(&pointer)
            {
                *leaf = with(leaf, self.names.name());
            }
        }
        serde_json::from_value(json)
            .unwrap_or_else(|error| panic!("free text of '{sort}' is not free everywhere: {error}"))
    }

    fn is_free<T: DeserializeOwned>(&mut self, json: &Value, pointer: &str, place: String) -> bool {
        if let Some(known) = self.free.get(&place) {
            return *known;
        }
        let mut tried = json.clone();
        if let Some(leaf) = tried.pointer_mut(pointer) {
            *leaf = with(leaf, TRIAL.to_owned());
        }
        let is_free = serde_json::from_value::<T>(tried).is_ok();
        self.free.insert(place, is_free);
        is_free
    }
}

/// A name where a text, nothing or an empty list is.
fn with(leaf: &Value, name: String) -> Value {
    if leaf.is_array() { Value::from(vec![name]) } else { Value::from(name) }
}

/// Every leaf that may be a text: its pointer, and the same with `*` for indices.
fn collect(value: &Value, (pointer, place): (String, String), leaves: &mut Vec<(String, String)>) {
    match value {
        Value::String(_) | Value::Null => leaves.push((pointer, place)),
        Value::Array(items) if items.is_empty() => leaves.push((pointer, place)),
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                collect(item, (format!("{pointer}/{index}"), format!("{place}/*")), leaves);
            }
        }
        Value::Object(fields) => {
            for (field, item) in fields.iter().filter(|(field, _)| !TOKENS.contains(&field.as_str())) {
                let part = field.replace('~', "~0").replace('/', "~1");
                collect(item, (format!("{pointer}/{part}"), format!("{place}/{part}")), leaves);
            }
        }
        Value::Bool(_) | Value::Number(_) => {}
    }
}
