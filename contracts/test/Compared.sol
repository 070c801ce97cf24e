// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Mirror} from "./Mirror.sol";

/// @dev Reads all of the contract's state about a few people and words, and asserts that it equals the mirror's.
abstract contract Compared is Mirror {
    /// @dev Tokens, digests, roots and devices are the words from 0; so epochs stay below this number.
    uint256 public constant WORDS = 10;

    AuthROS public authros;
    address[] internal people;

    function compare() external view {
        vm.assertEq(authros.administrator(), administrator, "administrator");
        vm.assertEq(authros.nominee(), nominee, "nominee");
        vm.assertEq(authros.open(), open, "open");
        vm.assertEq(authros.paused(), paused(), "paused");
        vm.assertEq(authros.pausedUntil(), pausedUntil, "end of the pause");
        vm.assertEq(authros.delay(), delay, "delay");
        for (uint256 index = 0; index < people.length; index++) {
            compareAccount(people[index]);
            compareWords(people[index]);
            for (uint256 other = 0; other < people.length; other++) {
                compareGrant(people[index], people[other]);
            }
        }
    }

    function compareAccount(address owner) private view {
        Account memory account;
        (account.identity, account.epoch, account.token, account.suspended, account.keys, account.count, account.last) =
            authros.accountOf(owner);
        Account memory held = accountOf[owner];
        vm.assertEq(account.identity, held.identity, "identity");
        (account.identity, held.identity) = ("", "");
        vm.assertEq(abi.encode(account), abi.encode(held), "account");
        vm.assertEq(authros.admitted(owner), admitted[owner], "admitted");
        vm.assertEq(authros.successorOf(owner), successorOf[owner], "successor");
        vm.assertEq(authros.headOf(owner), headOf[owner], "head");
        compareSuccession(owner);
        for (uint64 keys = 0; keys < 4; keys++) {
            Keys memory version;
            (version.identity, version.blockNumber, version.time) = authros.keysOf(owner, keys);
            vm.assertEq(abi.encode(version), abi.encode(keysOf[owner][keys]), "keys");
        }
        address heir = owner;
        for (uint256 step = 0; step < people.length; step++) {
            heir = authros.successorOf(heir);
        }
        vm.assertEq(heir, address(0), "who follows the successors comes to an end");
    }

    function compareSuccession(address owner) private view {
        Proposal memory proposal;
        (proposal.successor, proposal.due, proposal.recovery) = authros.proposalOf(owner);
        vm.assertEq(abi.encode(proposal), abi.encode(proposalOf[owner]), "proposal");
        (address recovery, address next, uint64 from) = authros.recoveryOf(owner);
        vm.assertEq(recovery, recoveryOf(owner), "recovery account");
        vm.assertEq(next, recoveries[owner].next, "recovery account named last");
        vm.assertEq(from, recoveries[owner].from, "since when");
    }

    function compareWords(address owner) private view {
        for (uint256 number = 0; number < WORDS; number++) {
            bytes32 word = bytes32(number);
            same(authros.epochOf(owner, word), epochOf[owner][word], "epoch of a token");
            same(authros.uploadedAt(owner, word), uploadedAt[owner][word], "block of a digest");
            Anchor memory anchored;
            (anchored.blockNumber, anchored.count, anchored.time, anchored.keys) = authros.anchorOf(owner, word);
            same(abi.encode(anchored), abi.encode(anchorOf[owner][word]), "anchor");
            Loan memory loan;
            (loan.active, loan.until, loan.lentAt, loan.recalledAt) = authros.loanOf(owner, word);
            same(abi.encode(loan), abi.encode(loanOf[owner][word]), "loan");
        }
    }

    function compareGrant(address owner, address reader) private view {
        Grant memory grant;
        (grant.active, grant.epoch, grant.expiry, grant.revokes, grant.scope) = authros.grantOf(owner, reader);
        vm.assertEq(abi.encode(grant), abi.encode(grantOf[owner][reader]), "grant");
        for (uint64 epoch = 0; epoch < WORDS; epoch++) {
            (uint64 revokes, uint64 keys) = authros.envelopeOf(owner, reader, epoch);
            same(revokes, envelopeOf[owner][reader][epoch].first, "revokes of an envelope");
            same(keys, envelopeOf[owner][reader][epoch].second, "keys of an envelope");
        }
    }

    function same(bytes memory left, bytes memory right, string memory message) private pure {
        if (keccak256(left) != keccak256(right)) vm.assertEq(left, right, message);
    }

    /// @dev Like assertEq, but without the cost of a call if it holds.
    function same(uint256 left, uint256 right, string memory message) private pure {
        if (left != right) vm.assertEq(left, right, message);
    }
}
