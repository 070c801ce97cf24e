//! The state of a robot's parts: joints, transforms, battery, diagnostics.

use super::numbers::{Body, as_float, float, floats, listed, number, shown, stamp, text, triple, turned};
use super::{MOST_ROWS, Readable, Table};
use crate::model::clean;
use crate::ros::message::Value;

pub(super) fn joints(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    let Some(Value::Array(names)) = value.get("name") else { return out };
    let column = |path: &str| -> Vec<String> {
        floats(value, path, body, usize::MAX).into_iter().map(|(_, value)| number(value)).collect()
    };
    let columns = [column("position"), column("velocity"), column("effort")];
    let rows = names.iter().take(MOST_ROWS).enumerate().map(|(at, name)| {
        let name = if let Value::Text(name) = name { clean(name, 60) } else { String::new() };
        let cells = columns.iter().map(|column| column.get(at).cloned().unwrap_or_else(|| String::from("-")));
        std::iter::once(name).chain(cells).collect()
    });
    let head = ["joint", "position, rad or m", "velocity", "effort"].map(String::from).to_vec();
    out.line("Joints", names.len().to_string());
    out.tables.push(Table { title: String::from("Joints"), head, rows: rows.collect() });
    out
}

pub(super) fn transforms(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    let head = ["parent", "child", "stamp", "translation, m", "orientation"];
    let table = listed("Transforms", &head, value, "transforms", |item| {
        vec![
            text(item, "header.frame_id"),
            text(item, "child_frame_id"),
            text(item, "header.stamp"),
            triple(item, "transform.translation"),
            turned(item, "transform.rotation"),
        ]
    });
    out.line("Transforms", table.rows.len().to_string());
    out.tables.push(table);
    out
}

pub(super) fn battery(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    let word = |path: &str, words: &[&str]| -> String {
        match value.get(path) {
            Some(Value::Unsigned(code)) => {
                let known = usize::try_from(*code).ok().and_then(|code| words.get(code));
                known.map_or_else(|| format!("code {code}"), |word| (*word).to_owned())
            }
            _ => String::from("-"),
        }
    };
    out.line("Stamp (UTC)", stamp(value));
    let share = float(value, "percentage").filter(|share| share.is_finite());
    out.line("Charge", share.map_or_else(|| String::from("unknown"), |share| format!("{} %", number(share * 100.0))));
    out.line("Voltage, V", shown(value, "voltage"));
    out.line("Current, A", shown(value, "current"));
    out.line("Temperature, °C", shown(value, "temperature"));
    out.line("Charge, Ah", format!("{} of {}", shown(value, "charge"), shown(value, "capacity")));
    out.line("Status", word("power_supply_status", &["unknown", "charging", "discharging", "not charging", "full"]));
    let health = ["unknown", "good", "overheat", "dead", "overvoltage", "failed", "cold", "watchdog", "safety timer"];
    out.line("Health", word("power_supply_health", &health));
    let present = value.get("present").and_then(as_float).is_some_and(|present| present > 0.0);
    out.line("Present", if present { "yes" } else { "no" });
    let cells: Vec<String> =
        floats(value, "cell_voltage", body, MOST_ROWS).into_iter().map(|(_, cell)| number(cell)).collect();
    if !cells.is_empty() {
        out.line("Cells, V", cells.join("  "));
    }
    out
}

pub(super) fn diagnostics(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    let head = ["level", "name", "message", "hardware"];
    let table = listed("Status", &head, value, "status", |item| {
        let level = match item.get("level") {
            Some(Value::Integer(0) | Value::Unsigned(0)) => "OK",
            Some(Value::Integer(1) | Value::Unsigned(1)) => "WARN",
            Some(Value::Integer(2) | Value::Unsigned(2)) => "ERROR",
            Some(Value::Integer(3) | Value::Unsigned(3)) => "STALE",
            _ => "?",
        };
        vec![level.to_owned(), text(item, "name"), text(item, "message"), text(item, "hardware_id")]
    });
    out.line("Parts", table.rows.len().to_string());
    let values = value.get("status").map(values).unwrap_or_default();
    out.tables.push(table);
    if !values.is_empty() {
        let head = ["part", "key", "value"].map(String::from).to_vec();
        out.tables.push(Table { title: String::from("Values"), head, rows: values });
    }
    out
}

fn values(status: &Value) -> Vec<Vec<String>> {
    let Value::Array(items) = status else { return Vec::new() };
    let pairs = items.iter().flat_map(|item| match item.get("values") {
        Some(Value::Array(pairs)) => pairs.iter().map(|pair| (item, pair)).collect(),
        _ => Vec::new(),
    });
    pairs.take(MOST_ROWS).map(|(item, pair)| vec![text(item, "name"), text(pair, "key"), text(pair, "value")]).collect()
}
