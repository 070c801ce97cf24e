// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Vm} from "./Vm.sol";
import {World} from "./World.sol";

contract IdentityTest is World {
    function test_registering_begins_epoch_one() public {
        bytes memory text = identity(7, 9);
        by(STRANGER);
        authros.register(text, "");
        emitted("Registered(address,bytes32,bytes)", abi.encode(STRANGER, uint256(7)), abi.encode(text));
        Account memory account = accountOf(STRANGER);
        vm.assertEq(account.identity, text, "identity");
        vm.assertEq(account.epoch, 1, "epoch");
        vm.assertEq(account.token, bytes32(uint256(7)), "token");
        vm.assertEq(account.keys, 1, "keys");
        vm.assertEq(account.count, 0, "count");
        vm.assertEq(account.last, bytes32(0), "last");
        vm.assertEq(account.suspended, false, "suspended");
        vm.assertEq(authros.epochOf(STRANGER, bytes32(uint256(7))), 1, "epoch of the token");
    }

    function test_every_version_of_the_keys_is_kept() public {
        vm.roll(70);
        vm.warp(2000);
        by(A);
        authros.rotateKeys(identity(0xa1, 9), "");
        (bytes32 kept, uint64 blockNumber, uint64 time) = authros.keysOf(A, 1);
        vm.assertEq(kept, keccak256(identity(0xa1, 1)), "the first");
        vm.assertEq(blockNumber, 1, "its block");
        vm.assertEq(time, 1000, "its time");
        (kept, blockNumber, time) = authros.keysOf(A, 2);
        vm.assertEq(kept, keccak256(identity(0xa1, 9)), "the second");
        vm.assertEq(blockNumber, 70, "its block");
        vm.assertEq(time, 2000, "its time");
        (kept,,) = authros.keysOf(A, 3);
        vm.assertEq(kept, bytes32(0), "no third");
    }

    function test_nobody_registers_twice() public {
        refused(A, "registered");
        authros.register(identity(0xa2, 1), "");
    }

    function test_an_identity_has_224_bytes_and_a_token() public {
        vm.assertEq(authros.IDENTITY_LENGTH(), 224, "length");
        refused(STRANGER, "length");
        authros.register("", "");
        refused(STRANGER, "length");
        authros.register(filled(223, 1), "");
        refused(STRANGER, "length");
        authros.register(filled(225, 1), "");
        refused(STRANGER, "empty");
        authros.register(identity(0, 1), "");
    }

    function test_tokens_are_per_owner_so_nobody_takes_anothers_first() public {
        register(STRANGER, 0xa1);
        vm.assertEq(accountOf(STRANGER).token, accountOf(A).token, "the same token");
    }

    function test_closed_registration_takes_whom_the_administrator_admits() public {
        authros = deploy(false);
        refused(STRANGER, "closed");
        authros.register(identity(7, 1), "");
        by(ADMIN);
        authros.admit(STRANGER);
        register(STRANGER, 7);
        by(ADMIN);
        authros.dismiss(STRANGER);
        vm.assertEq(accountOf(STRANGER).epoch, 1, "stays registered");
        refused(A, "closed");
        authros.register(identity(7, 1), "");
        by(ADMIN);
        authros.setOpen(true);
        register(A, 7);
    }

    function test_new_keys_go_on_in_the_epoch() public {
        rotate(A, 0xa2);
        bytes memory text = identity(0xa2, 5);
        by(A);
        authros.rotateKeys(text, "");
        emitted("KeysRotated(address,uint64,bytes,bytes)", abi.encode(A), abi.encode(uint64(2), text, ""));
        Account memory account = accountOf(A);
        vm.assertEq(account.identity, text, "identity");
        vm.assertEq(account.keys, 2, "keys");
        vm.assertEq(account.epoch, 2, "epoch");
        vm.assertEq(account.token, bytes32(uint256(0xa2)), "token");
    }

    function test_new_keys_come_under_the_current_token() public {
        rotate(A, 0xa2);
        refused(A, "token unknown");
        authros.rotateKeys(identity(0xa1, 5), "");
        refused(A, "token unknown");
        authros.rotateKeys(identity(0xa3, 5), "");
        refused(A, "length");
        authros.rotateKeys(filled(223, 1), "");
        refused(STRANGER, "unregistered");
        authros.rotateKeys(identity(0xa1, 5), "");
    }

    function test_a_rotation_begins_the_next_epoch() public {
        by(A);
        authros.rotate(bytes32(uint256(0xa2)), "");
        emitted("Rotated(address,uint64,bytes32)", abi.encode(A), abi.encode(uint64(2), uint256(0xa2)));
        vm.assertEq(accountOf(A).epoch, 2, "epoch");
        vm.assertEq(accountOf(A).token, bytes32(uint256(0xa2)), "token");
        vm.assertEq(accountOf(A).identity, identity(0xa1, 1), "identity stays");
        vm.assertEq(authros.epochOf(A, bytes32(uint256(0xa1))), 1, "the old token keeps its epoch");
        vm.assertEq(authros.epochOf(A, bytes32(uint256(0xa2))), 2, "the new one has the next");
    }

    function test_what_begins_an_epoch_carries_its_key_for_the_owner_itself() public {
        by(STRANGER);
        authros.register(identity(7, 9), "first");
        keptForItself(STRANGER, 1, "first");
        by(A);
        authros.rotate(bytes32(uint256(0xa2)), "second");
        keptForItself(A, 2, "second");
        grant(A, B, 2);
        by(A);
        authros.authorityRevoke(B, bytes32(uint256(0xa3)), "third");
        keptForItself(A, 3, "third");
        (uint64 revokes, uint64 keys) = authros.envelopeOf(A, A, 3);
        vm.assertEq(revokes + keys, 0, "nothing is stored");
    }

    function test_new_keys_are_handed_over_in_their_event() public {
        bytes memory text = identity(0xa1, 5);
        by(A);
        authros.rotateKeys(text, "pairs");
        emitted("KeysRotated(address,uint64,bytes,bytes)", abi.encode(A), abi.encode(uint64(2), text, bytes("pairs")));
    }

    function test_an_envelope_for_the_owner_has_its_bound() public {
        bytes memory longest = filled(authros.LONGEST_ENVELOPE(), 1);
        bytes memory longer = filled(longest.length + 1, 1);
        refused(STRANGER, "envelope");
        authros.register(identity(7, 9), longer);
        refused(A, "envelope");
        authros.rotate(bytes32(uint256(0xa2)), longer);
        refused(A, "envelope");
        authros.rotateKeys(identity(0xa1, 5), longer);
        grant(A, B, 1);
        refused(A, "envelope");
        authros.authorityRevoke(B, bytes32(uint256(0xa2)), longer);
        by(A);
        authros.rotate(bytes32(uint256(0xa2)), longest);
        by(A);
        authros.rotateKeys(identity(0xa2, 5), longest);
        vm.assertEq(accountOf(A).keys, 2, "keys");
        vm.assertEq(accountOf(A).epoch, 2, "epoch");
    }

    /// @dev The last call's second event is the envelope of `epoch`, from the owner to itself.
    function keptForItself(address owner, uint64 epoch, bytes memory envelope) private {
        Vm.Log[] memory logs = vm.getRecordedLogs();
        vm.assertEq(logs.length, 2, "two events");
        bytes memory topics_ =
            abi.encodePacked(keccak256("Wrapped(address,address,uint64,bytes)"), abi.encode(owner, owner));
        vm.assertEq(abi.encodePacked(logs[1].topics), topics_, "topics of the event");
        vm.assertEq(logs[1].data, abi.encode(epoch, envelope), "data of the event");
    }

    function test_a_token_is_used_once() public {
        refused(A, "empty");
        authros.rotate(bytes32(0), "");
        refused(A, "token used");
        authros.rotate(bytes32(uint256(0xa1)), "");
        rotate(A, 0xb1);
        refused(STRANGER, "unregistered");
        authros.rotate(bytes32(uint256(7)), "");
    }

    function test_the_unregistered_have_nothing() public view {
        Account memory account = accountOf(STRANGER);
        vm.assertEq(account.identity, "", "identity");
        vm.assertEq(account.epoch + account.keys + account.count, 0, "numbers");
        vm.assertEq(account.token | account.last, bytes32(0), "words");
    }

    function test_no_ether_and_no_unknown_call_is_taken() public {
        vm.deal(A, 10);
        bytes[3] memory calls = [
            bytes(""),
            abi.encodeWithSelector(0x01020304),
            abi.encodeWithSelector(authros.rotate.selector, uint256(0xa2), "")
        ];
        for (uint256 index = 0; index < calls.length; index++) {
            uint256 ether_ = index == 1 ? 0 : 1;
            vm.prank(A);
            (bool taken,) = address(authros).call{value: ether_}(calls[index]);
            vm.assertEq(taken, false, "taken");
        }
        vm.assertEq(address(authros).balance, 0, "balance");
        vm.assertEq(accountOf(A).epoch, 1, "epoch");
    }
}
