// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Mirror} from "./Mirror.sol";

/// @dev Reads all of the contract's state about a few people and words, and asserts that it is what the mirror holds.
abstract contract Compared is Mirror {
    /// @dev Tokens, digests, roots and devices are the words from 0 on; so epochs stay below this number.
    uint256 public constant WORDS = 10;

    AuthROS public authros;
    address[] internal people;

    function compare() external view {
        vm.assertEq(authros.administrator(), administrator, "administrator");
        vm.assertEq(authros.nominee(), nominee, "nominee");
        vm.assertEq(authros.open(), open, "open");
        vm.assertEq(authros.paused(), paused, "paused");
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
        address heir = owner;
        for (uint256 step = 0; step < people.length; step++) {
            heir = authros.successorOf(heir);
        }
        vm.assertEq(heir, address(0), "who follows the successors comes to an end");
    }

    function compareWords(address owner) private view {
        for (uint256 number = 0; number < WORDS; number++) {
            bytes32 word = bytes32(number);
            same(authros.epochOf(owner, word), epochOf[owner][word], "epoch of a token");
            same(authros.uploadedAt(owner, word), uploadedAt[owner][word], "block of a digest");
            (uint64 blockNumber, uint64 count) = authros.anchorOf(owner, word);
            same(blockNumber, anchorOf[owner][word].first, "block of an anchor");
            same(count, anchorOf[owner][word].second, "count of an anchor");
            (bool active, uint64 until) = authros.loanOf(owner, word);
            same(active ? 1 : 0, loanOf[owner][word].active ? 1 : 0, "loan");
            same(until, loanOf[owner][word].until, "end of a loan");
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

    /// @dev As assertEq, but without the cost of a call where it holds.
    function same(uint256 left, uint256 right, string memory message) private pure {
        if (left != right) vm.assertEq(left, right, message);
    }
}
