//! A ROS 2 definition with every nested type resolved. A definition that parses has no cycles and bounded depth and
//! size.

use std::borrow::Cow;

use super::super::definition::{LONGEST_DEFINITION, MOST_TYPES};
use super::super::line::Primitive;
use super::super::nesting::{Nesting, Texts};
use super::line::{Line, Many, is_name, parse_line, plain};
use crate::model::topic::LONGEST_NAME;
use crate::ros::RosError;

/// The type of a member.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    Plain {
        primitive: Primitive,
        /// Its number in type descriptions.
        number: u8,
    },
    /// Index of an interface.
    Interface(usize),
}

/// One member of an interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Member {
    pub name: String,
    pub of: Of,
    pub many: Many,
    /// The most characters of a text; 0 if unbounded.
    pub bound: usize,
    /// The type as written, with its brackets.
    pub written: String,
}

/// One type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Interface {
    /// `package/msg/Type`.
    pub name: String,
    pub members: Vec<Member>,
}

/// A type with all the types it consists of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Schema {
    /// The type itself is last; each comes after those it consists of.
    pub interfaces: Vec<Interface>,
}

impl Schema {
    /// Parses the type's own lines and the sections after them.
    pub fn parse(type_name: &str, text: &str) -> Result<Self, RosError> {
        let failed = |reason: String| RosError::definition(type_name, reason);
        let name = full_name(type_name, None).ok_or_else(|| failed("its type is not package/msg/Type".into()))?;
        if text.len() > LONGEST_DEFINITION {
            return Err(failed(format!("it is longer than {LONGEST_DEFINITION} bytes")));
        }
        let texts = sections(&name, text).map_err(failed)?;
        let interfaces = Nesting::layouts_of(&name, texts, interface).map_err(failed)?;
        Ok(Self { interfaces })
    }
}

/// Splits the text at its `MSG:` lines; a type given twice keeps its first text.
pub(super) fn sections<'a>(type_name: &str, text: &'a str) -> Result<Texts<'a>, String> {
    let mut found: Vec<(String, Vec<&str>)> = vec![(type_name.to_owned(), Vec::new())];
    let mut after_rule = false;
    for line in text.lines() {
        let rule = line.len() >= 20 && line.bytes().all(|byte| byte == b'=');
        let name = line.strip_prefix("MSG: ").filter(|_| after_rule);
        if let Some(name) = name.and_then(|name| full_name(name.trim(), None)) {
            found.push((name, Vec::new()));
        } else if after_rule && line.starts_with("IDL: ") {
            return Err("part of it is IDL, which is not supported".into());
        } else if let (false, Some((_, lines))) = (rule, found.last_mut()) {
            lines.push(line);
        }
        after_rule = rule;
        if found.len() > MOST_TYPES {
            return Err(format!("it has more than {MOST_TYPES} types"));
        }
    }
    let mut texts = Texts::new();
    for (name, lines) in found {
        texts.entry(name).or_insert(lines);
    }
    Ok(texts)
}

/// The text of a type in MCAP's form. rosbag2 describes the event of a service (`package/srv/Type_Event`) by the service's own
/// text, in which a line of dashes divides request and response.
pub(in super::super::super) fn plain_text<'a>(type_name: &str, text: &'a str) -> Cow<'a, str> {
    const RULE: &str = "================================================================================";
    let service = type_name.strip_suffix("_Event").filter(|name| name.contains("/srv/"));
    let headless = || text.strip_prefix(RULE)?.trim_start().strip_prefix("SRV: ")?.split_once('\n');
    let content = headless().map_or(text, |(_, rest)| rest);
    let (own, others) = content.find("\n====").map_or((content, ""), |end| content.split_at(end));
    let is_divider = |line: &str| line.trim_end() == "---";
    let Some(service) = service.filter(|_| own.lines().any(is_divider)) else { return text.into() };
    let lines: Vec<&str> = own.lines().collect();
    let request = lines.split(|line| is_divider(line)).next().unwrap_or_default();
    let response = lines.get(request.len() + 1..).unwrap_or_default();
    let part = |name: &str, lines: &[&str]| format!("{RULE}\nMSG: {service}_{name}\n{}\n", lines.join("\n"));
    let members = ["Request", "Response"].map(|name| format!("{service}_{name}[<=1] {}\n", name.to_lowercase()));
    let (members, request, response) = (members.concat(), part("Request", request), part("Response", response));
    format!("service_msgs/ServiceEventInfo info\n{members}{request}{response}{}", others.trim_start()).into()
}

/// `package/msg/Type` from any way of writing the name; a bare name belongs to the package it occurs in.
pub(super) fn full_name(name: &str, package: Option<&str>) -> Option<String> {
    let parts: Vec<&str> = name.split('/').collect();
    let full = match (parts.as_slice(), package) {
        ([package, kind @ ("msg" | "srv" | "action"), name], _) => {
            format!("{package}/{kind}/{name}")
        }
        ([package, name], _) => format!("{package}/msg/{name}"),
        ([name], Some(package)) => format!("{package}/msg/{name}"),
        _ => return None,
    };
    (full.len() <= LONGEST_NAME && parts.iter().all(|part| is_name(part))).then_some(full)
}

/// The interface of a type and its number of levels.
fn interface(nesting: &mut Nesting<'_, Interface>, name: &str, lines: &[&str]) -> Result<(Interface, usize), String> {
    let mut members = Vec::new();
    let mut height = 1;
    for line in lines {
        let read = parse_line(line).map_err(|reason| format!("{reason} in {name}"))?;
        let Some(Line::Field { written, base, bound, many, name: member }) = read else { continue };
        let (of, below) = what(nesting, name, base)?;
        height = height.max(below + 1);
        let (name, written) = (member.to_owned(), written.to_owned());
        members.push(Member { name, of, many, bound, written });
    }
    Ok((Interface { name: name.to_owned(), members }, height))
}

fn what(nesting: &mut Nesting<'_, Interface>, inside: &str, base: &str) -> Result<(Of, usize), String> {
    if let Some((primitive, number)) = plain(base) {
        return Ok((Of::Plain { primitive, number }, 0));
    }
    let package = inside.split('/').next();
    let full = full_name(base, package).ok_or_else(|| format!("a type's name is broken in {inside}"))?;
    let (index, height) = nesting.resolve(&full, interface)?;
    Ok((Of::Interface(index), height))
}
