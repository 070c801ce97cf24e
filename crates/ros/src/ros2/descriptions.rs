//! Definitions of types that are not built in, requested from the nodes that publish them (`~/get_type_description`). A text
//! is accepted only if its hash is the one that the publisher announced. A node of ROS 2 gives its texts with characters beyond
//! ASCII escaped, and cut by as many; what is written from its structured description counts then.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::model::clean;
use crate::pipe::read::{Wish, Writer};
use crate::ros::message::{is_built_in, type_hash};

/// The most types that are asked for.
const MOST_TYPES: usize = 4096;
/// The most publishers whose nodes are asked for one type.
const MOST_ASKED: usize = 16;

/// What is known of a type.
enum Description {
    /// The nodes that were asked, by the publisher for which that was: a node that was started anew is asked again.
    Asked(BTreeMap<String, String>),
    /// The text, with all the types it consists of.
    Known(Arc<str>),
    /// It is built into this program.
    BuiltIn,
}

/// The types, by name and hash.
#[derive(Default)]
pub struct Descriptions(HashMap<(String, String), Description>);

fn key(writer: &Writer) -> Option<(String, String)> {
    Some((writer.type_name.clone(), writer.type_hash.clone()?))
}

impl Descriptions {
    /// The question to be asked because of a publisher whose messages are captured.
    pub fn wanted(&mut self, writer: &Writer) -> Option<Wish> {
        let (node, (type_name, hash)) = (writer.node.clone()?, key(writer)?);
        if self.0.len() >= MOST_TYPES && !self.0.contains_key(&(type_name.clone(), hash.clone())) {
            return None;
        }
        let first = || match is_built_in(&type_name, &hash) {
            true => Description::BuiltIn,
            false => Description::Asked(BTreeMap::new()),
        };
        let known = self.0.entry((type_name.clone(), hash.clone())).or_insert_with(first);
        let Description::Asked(asked) = known else { return None };
        let is_new = asked.len() < MOST_ASKED && asked.insert(writer.id.clone(), node.clone()).is_none();
        is_new.then_some(Wish::Describe { node, type_name, type_hash: hash })
    }

    /// The text for a publisher's messages; empty if there is none.
    pub fn text_of(&self, writer: &Writer) -> Arc<str> {
        match key(writer).and_then(|key| self.0.get(&key)) {
            Some(Description::Known(text)) => Arc::clone(text),
            _ => "".into(),
        }
    }

    /// Takes a node's answer, of which the first text that has the hash counts; whether one is known now that was not before.
    ///
    /// # Errors
    /// What is wrong with the texts, in words.
    pub fn take(
        &mut self,
        node: &str,
        (type_name, hash): (String, String),
        texts: [Vec<u8>; 2],
    ) -> Result<bool, String> {
        let Some(Description::Asked(asked)) = self.0.get(&(type_name.clone(), hash.clone())) else { return Ok(false) };
        if !asked.values().any(|known| known == node) {
            return Ok(false);
        }
        let mut wrong = None;
        for text in texts.into_iter().filter(|text| !text.is_empty()) {
            match fitting(&type_name, &hash, text) {
                Ok(text) => {
                    self.0.insert((type_name, hash), Description::Known(text.into()));
                    return Ok(true);
                }
                Err(reason) => drop(wrong.get_or_insert(reason)),
            }
        }
        Err(wrong.unwrap_or_else(|| "the definition it gave is empty".to_owned()))
    }

    /// The program that asks was started anew: who has not answered is asked again.
    pub fn ask_again(&mut self) {
        self.0.retain(|_, known| !matches!(known, Description::Asked(_)));
    }
}

/// A text, if it has the hash.
fn fitting(type_name: &str, hash: &str, text: Vec<u8>) -> Result<String, String> {
    let text = String::from_utf8(text).map_err(|_| "the definition it gave is no text".to_owned())?;
    match type_hash(type_name, &text) {
        Ok(found) if found == hash => Ok(text),
        Ok(found) => Err(format!(
            "the definition it gave of {} has the hash {found}, its messages have {}; it is not used",
            clean(type_name, 255),
            clean(hash, 80)
        )),
        Err(error) => Err(format!("the definition it gave is not used: {}", clean(&error.to_string(), 300))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipe::read::Quality;

    /// By rosbags 0.11.9, of the text below.
    const GRIP: &str = "RIHS01_3e789e2509f81d797131bc8cbc2e060199fd1af28e8d4a51b73e5e6adc25b74d";
    const TEXT: &str = "std_msgs/Header header\nfloat64 force\nstring<=16 label\n";

    fn writer(node: &str, type_name: &str, hash: Option<&str>) -> Writer {
        Writer {
            id: format!("0110 of {node}"),
            topic: "/grip".into(),
            type_name: type_name.into(),
            type_hash: hash.map(str::to_owned),
            quality: Quality::default(),
            node: Some(node.into()),
            naming: false,
            vendor: "fastdds".into(),
        }
    }

    fn whole() -> String {
        let rule = "=".repeat(80);
        format!(
            "{TEXT}{rule}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{rule}\n\
             MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        )
    }

    #[test]
    fn a_text_counts_if_its_hash_is_the_announced_one_and_it_was_asked_for() {
        let mut descriptions = Descriptions::default();
        let grip = writer("/hand", "rig_msgs/msg/Grip", Some(GRIP));
        let asked = || ("rig_msgs/msg/Grip".to_owned(), GRIP.to_owned());
        let own = |text: Vec<u8>| [text, Vec::new()];
        assert_eq!(descriptions.take("/hand", asked(), own(whole().into_bytes())), Ok(false), "nobody asked");
        let (type_name, type_hash) = asked();
        let wish = Wish::Describe { node: "/hand".into(), type_name, type_hash };
        assert_eq!((descriptions.wanted(&grip), descriptions.wanted(&grip)), (Some(wish), None), "once");
        assert_eq!(descriptions.take("/other", asked(), own(whole().into_bytes())), Ok(false), "another was asked");
        let lie = whole().replace("float64 force", "float64 power");
        let refused = descriptions.take("/hand", asked(), own(lie.clone().into_bytes())).expect_err("a lie");
        assert!(refused.contains("not used") && refused.contains(GRIP), "{refused}");
        assert!(descriptions.take("/hand", asked(), own(vec![0xff])).is_err());
        assert!(descriptions.take("/hand", asked(), own(b"no text at all".to_vec())).is_err());
        assert_eq!(&*descriptions.text_of(&grip), "");
        assert!(descriptions.wanted(&writer("/other", "rig_msgs/msg/Grip", Some(GRIP))).is_some(), "the next is asked");
        // As rclpy gives it: escaped, and cut.
        let cut = whole().replace("force\n", "force # 10\\xc2\\xb0\n").into_bytes();
        let cut = cut.get(..cut.len() - 12).expect("long").to_vec();
        assert_eq!(descriptions.take("/other", asked(), [cut, whole().into_bytes()]), Ok(true));
        assert_eq!(&*descriptions.text_of(&grip), whole());
        assert_eq!(descriptions.wanted(&writer("/third", "rig_msgs/msg/Grip", Some(GRIP))), None);
    }

    #[test]
    fn nobody_is_asked_for_what_is_built_in_or_cannot_be_compared() {
        const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let mut descriptions = Descriptions::default();
        assert_eq!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(STRING))), None);
        assert_eq!(descriptions.wanted(&writer("/a", "rig_msgs/msg/Grip", None)), None);
        // Another release's: its hash differs.
        assert!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(GRIP))).is_some());
        descriptions.ask_again();
        assert!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(GRIP))).is_some());
    }
}
