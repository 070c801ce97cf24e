//! A node that answers one question with a wrong number holds nothing up once it answers truly again.

use super::NO_NODE;
use super::field::{Field, Mode};
use crate::support::{Anvil, Proxy, Spoil, heavy, long, skipped, wait_until};

/// 0; 2^32; the estimate that was seen on a real network; 2^64 - 1; 2^256 - 1; no number; nothing.
const WRONG: [&str; 7] = [
    r#""0x0""#,
    r#""0x100000000""#,
    r#""0x13b0055da""#,
    r#""0xffffffffffffffff""#,
    r#""0xffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff""#,
    r#""many""#,
    "null",
];
/// What is signed by the answer, and lasts.
const SIGNED_BY: [&str; 2] = ["eth_estimateGas", "eth_getTransactionCount"];
const FURTHER: [&str; 4] = ["eth_gasPrice", "eth_blockNumber", "eth_chainId", "eth_getBalance"];
/// Uses of each method that are answered wrongly in the long run: one, or several in a row.
const USES: u64 = 3;

#[test]
fn a_wrong_number_delays_anchoring_only_until_the_node_answers_truly_again() {
    let _alone = heavy();
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let field = Field::open(&proxy.http(), Mode::Batch, &[]);
    node.set_interval(1);
    let (methods, uses) = if long() { ([&SIGNED_BY[..], &FURTHER].concat(), USES) } else { (SIGNED_BY.to_vec(), 1) };
    for method in methods {
        // The mined and the pending nonce are two questions; told the same, neither contradicts the other.
        let twice = (method == "eth_getTransactionCount" && uses == 1).then_some((WRONG[1], 2));
        let each = WRONG.into_iter().flat_map(|answer| (1..=uses).map(move |times| (answer, times)));
        for (answer, times) in each.chain(twice) {
            proxy.spoil(method, Spoil::Answer(answer), times);
            // A registration and a change of keys are estimated each time, anchors once and then remembered.
            field.grow(1);
            let rotated = field.authros.run(&["keys", "rotate"]).code;
            proxy.calm();
            field.expect_settled(&node, 60);
            if rotated != Some(0) {
                field.authros.json(&["keys", "rotate"]);
            }
            println!("{method} answered {answer} {} times: rotate ended with {rotated:?}", proxy.spoilt());
        }
    }
    wait_until(60, "nothing is left open", || (field.pending() == 0).then_some(()));
}
