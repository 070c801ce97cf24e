//! Tries compared with another implementation's roots (@ethereumjs/mpt 10), and the nodes they create and leave behind.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use ethers::utils::keccak256;

use super::trie::{EMPTY_ROOT, Nodes, Trie, Turnover, below, list_root};
use crate::ChainError;
use crate::model::Hash;

/// Nodes in memory, with their number of places.
#[derive(Default)]
struct Shelf(RefCell<HashMap<Hash, (Vec<u8>, i64)>>);

impl Nodes for Shelf {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        let found = self.0.borrow().get(&hash).map(|(body, _)| body.as_slice().into());
        found.ok_or_else(|| ChainError::Internal(format!("{hash} is gone")))
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        ChainError::Internal(format!("{hash} is malformed"))
    }
}

impl Shelf {
    fn turn_over(&self, turnover: Turnover) {
        let mut nodes = self.0.borrow_mut();
        for (hash, body) in turnover.made {
            assert_eq!(keccak256(&body), hash.0);
            nodes.entry(hash).or_insert((body, 0)).1 += 1;
        }
        for hash in turnover.left {
            let places = &mut nodes.get_mut(&hash).expect("it was there").1;
            *places -= 1;
            if *places == 0 {
                nodes.remove(&hash);
            }
        }
    }

    /// The nodes below a root, each once.
    fn reached(&self, root: Hash) -> HashSet<Hash> {
        let (mut seen, mut next) = (HashSet::new(), vec![root]);
        while let Some(hash) = next.pop().filter(|_| root != EMPTY_ROOT) {
            seen.insert(hash);
            next.extend(below(&self.node(hash).expect("reached")).expect("a node"));
        }
        seen
    }
}

/// The same random draws as the other implementation's.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }
}

fn byte(value: u64) -> u8 {
    u8::try_from(value & 255).expect("a byte")
}

fn step(draws: &mut Draws) -> ([u8; 32], Option<Vec<u8>>) {
    let mut key = [0; 32];
    let number = draws.next() % 300;
    (key[0], key[1], key[30], key[31]) = (byte(number % 4), 7, byte(number >> 4), byte(number));
    if number.is_multiple_of(5) {
        key[2] = byte(number);
    }
    if draws.next().is_multiple_of(3) {
        return (key, None);
    }
    let length = 1 + draws.next() % 40;
    (key, Some(vec![byte(1 + draws.next() % 255); usize::try_from(length).expect("small")]))
}

/// The other implementation's roots after this many steps.
const ROOTS: [(usize, &str); 7] = [
    (10, "5c0e7c0ef40442efa28a4b2270c375cd86d87bd169fe699fc1042a4d945dcba6"),
    (500, "e085db8a8f6be554b501a09786c203881c9445ba95cdc2c9f8cc4912efb45099"),
    (1_000, "b15a153d6082b1665328022ebd05763c4f832855b401335ad78f0954b112d82d"),
    (1_500, "e4787ec457ba2e98589918047db4114844f85ea500169592cffcb4e15faf1fef"),
    (2_000, "d98a14d3f41b9cb775036d32d04da7a7ada1f008e57f3894b507e1a605f19e38"),
    (2_500, "1e6921da7b79ef402f2421a34c8c2ac9e13fd83056fbb829bda8efa2d18c87a9"),
    (3_000, "fe5b0258faca61f33fe0710f96aaa18bc76717c6e778279e915e553d31cf31f0"),
];

#[test]
fn roots_are_the_other_implementations_and_no_node_is_left_or_lost() {
    for at_once in [1, 7, 100] {
        let (shelf, mut draws, mut root) = (Shelf::default(), Draws(1), EMPTY_ROOT);
        let mut expected = ROOTS.iter().copied().peekable();
        let mut model: HashMap<[u8; 32], Vec<u8>> = HashMap::new();
        let mut trie = Trie::new(&shelf, root);
        for number in 1..=3_000 {
            let (key, value) = step(&mut draws);
            match &value {
                Some(value) => drop(model.insert(key, value.clone())),
                None => drop(model.remove(&key)),
            }
            trie.set(&key, value).expect("sets");
            let due = expected.next_if(|(at, _)| *at == number);
            if due.is_none() && number % at_once != 0 {
                continue;
            }
            let (next, turnover) = trie.finish();
            root = next;
            shelf.turn_over(turnover);
            trie = Trie::new(&shelf, root);
            if let Some((_, expected)) = due {
                assert_eq!(root.to_hex(), expected, "after {number} steps");
                let kept: HashSet<Hash> = shelf.0.borrow().keys().copied().collect();
                assert_eq!(kept, shelf.reached(root));
            }
        }
        for (key, value) in &model {
            assert_eq!(trie.get(key).expect("reads").as_ref(), Some(value));
            let (proven, way) = trie.prove(key).expect("proves");
            assert_eq!(proven.as_ref(), Some(value));
            assert_eq!(keccak256(&way[0]), root.0);
        }
        for key in model.keys() {
            trie.set(key, None).expect("takes out");
        }
        let (root, turnover) = trie.finish();
        shelf.turn_over(turnover);
        assert_eq!((root, shelf.0.borrow().len()), (EMPTY_ROOT, 0));
    }
}

#[test]
fn lists_have_the_other_implementations_roots() {
    for (count, length, expected) in [
        (1u64, 3, "9aec5889720771f7928754bc2baaeb632274feba5c67b6ef111620fb4d4e8fed"),
        (2, 40, "1c0bb17bad054ce9fdaae14c0d5f43fcfc6495884405bf3c9cdd2a13b166206d"),
        (17, 5, "aea120af7e4356d9719226903fdfc97df8003b3209dbce5eed10724b08611d17"),
        (129, 40, "5ac99c0b49117972e0c4dfdce3a2f186766f106b33c631ba5aa61e94bddcbd92"),
        (300, 110, "759f8b5256422c0926432becc9e0f5bd755b590fd511f605aa8297eabe5b5b84"),
    ] {
        let items: Vec<Vec<u8>> = (0..count).map(|place| vec![byte(place); length]).collect();
        assert_eq!(list_root(&items).to_hex(), expected);
    }
    assert_eq!(list_root(&[] as &[Vec<u8>]), EMPTY_ROOT);
}

#[test]
fn what_is_no_node_is_named() {
    let shelf = Shelf::default();
    let mut trie = Trie::new(&shelf, EMPTY_ROOT);
    for key in 0..50 {
        trie.set(&[key; 32], Some(vec![key; 40])).expect("sets");
    }
    let (root, turnover) = trie.finish();
    shelf.turn_over(turnover);
    let hashes: Vec<Hash> = shelf.0.borrow().keys().copied().collect();
    for hash in hashes {
        let good = shelf.0.borrow()[&hash].clone();
        for noise in [vec![], vec![0x80], vec![0xc0], vec![0xc3, 1, 2, 3], vec![0xff; 40], good.0[..20].to_vec()] {
            shelf.0.borrow_mut().get_mut(&hash).expect("there").0 = noise;
            for key in 0..50 {
                if let Err(error) = Trie::new(&shelf, root).get(&[key; 32]) {
                    assert_eq!(error, shelf.malformed(hash));
                }
                drop(Trie::new(&shelf, root).set(&[key; 32], None));
            }
        }
        *shelf.0.borrow_mut().get_mut(&hash).expect("there") = good;
    }
}
