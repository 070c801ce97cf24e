// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {World} from "./World.sol";

/// @dev The administrator's limits: successions wait and can be stopped, pauses end.
contract SuccessionTest is World {
    address private constant FRIEND = address(0xee0000);
    address private constant THIEF = address(0xdd0000);

    function test_the_delay_is_a_day_to_a_year() public {
        uint64[4] memory delays = [uint64(1 days), 365 days, 1 days - 1, 365 days + 1];
        for (uint256 index = 0; index < delays.length; index++) {
            if (index > 1) vm.expectRevert("delay");
            AuthROS deployed = new AuthROS(true, delays[index]);
            if (index <= 1) vm.assertEq(deployed.delay(), delays[index], "delay");
        }
    }

    function test_without_a_recovery_account_a_succession_waits_twice_the_delay() public {
        by(ADMIN);
        authros.proposeSuccession(A, B);
        uint64 due = 1000 + 2 * DELAY;
        emitted("SuccessionProposed(address,address,address,uint64)", abi.encode(A, B), abi.encode(address(0), due));
        (address successor, uint64 kept, address recovery) = authros.proposalOf(A);
        vm.assertEq(successor, B, "successor");
        vm.assertEq(kept, due, "due");
        vm.assertEq(recovery, address(0), "nobody");
        vm.assertEq(accountOf(A).suspended, false, "not yet");
        vm.warp(due - 1);
        refused(ADMIN, "early");
        authros.completeSuccession(A);
        vm.warp(due);
        by(STRANGER);
        authros.completeSuccession(A);
        emitted("Succeeded(address,address)", abi.encode(A, B), "");
        vm.assertEq(authros.successorOf(A), B, "successor");
        vm.assertEq(accountOf(A).suspended, true, "suspended");
        (, kept,) = authros.proposalOf(A);
        vm.assertEq(kept, 0, "done");
        refused(ADMIN, "no proposal");
        authros.completeSuccession(A);
        refused(ADMIN, "succeeded");
        authros.restore(A);
        refused(ADMIN, "succeeded");
        authros.proposeSuccession(A, C);
    }

    function test_with_a_recovery_account_it_waits_the_delay_and_that_account_stops_it() public {
        name(A, FRIEND);
        vm.warp(1000 + DELAY);
        by(ADMIN);
        authros.proposeSuccession(A, B);
        uint64 due = 1000 + 2 * DELAY;
        emitted("SuccessionProposed(address,address,address,uint64)", abi.encode(A, B), abi.encode(FRIEND, due));
        refused(ADMIN, "pending");
        authros.proposeSuccession(A, C);
        address[4] memory others = [A, B, C, STRANGER];
        for (uint256 index = 0; index < others.length; index++) {
            refused(others[index], "recovery");
            authros.cancelSuccession(A);
        }
        by(ADMIN);
        authros.suspend(FRIEND);
        by(ADMIN);
        authros.pause(uint64(block.timestamp) + 1);
        by(FRIEND);
        authros.cancelSuccession(A);
        emitted("SuccessionCancelled(address,address)", abi.encode(A, FRIEND), "");
        vm.warp(due);
        refused(ADMIN, "no proposal");
        authros.completeSuccession(A);
        refused(FRIEND, "no proposal");
        authros.cancelSuccession(A);
        vm.assertEq(accountOf(A).suspended, false, "as before");
    }

    function test_a_succession_that_nobody_stopped_is_completed() public {
        name(A, FRIEND);
        vm.warp(1000 + DELAY);
        by(ADMIN);
        authros.proposeSuccession(A, B);
        vm.warp(1000 + 2 * DELAY - 1);
        refused(B, "early");
        authros.completeSuccession(A);
        vm.warp(1000 + 2 * DELAY);
        by(B);
        authros.completeSuccession(A);
        vm.assertEq(authros.successorOf(A), B, "successor");
    }

    function test_the_administrator_withdraws_a_proposal() public {
        by(ADMIN);
        authros.proposeSuccession(A, B);
        by(ADMIN);
        authros.cancelSuccession(A);
        by(ADMIN);
        authros.proposeSuccession(A, C);
        (address successor,,) = authros.proposalOf(A);
        vm.assertEq(successor, C, "another");
    }

    function test_naming_a_recovery_account_takes_effect_after_the_delay() public {
        by(A);
        authros.nameRecovery(FRIEND);
        uint64 from = 1000 + DELAY;
        emitted("RecoveryNamed(address,address,uint64)", abi.encode(A, FRIEND), abi.encode(from));
        inEffect(A, address(0), FRIEND, from);
        vm.warp(from - 1);
        inEffect(A, address(0), FRIEND, from);
        vm.warp(from);
        inEffect(A, FRIEND, FRIEND, from);
        name(A, C);
        inEffect(A, FRIEND, C, from + DELAY);
        name(A, B);
        inEffect(A, FRIEND, B, from + DELAY);
        vm.warp(from + DELAY);
        inEffect(A, B, B, from + DELAY);
        name(A, address(0));
        vm.warp(from + 2 * DELAY);
        inEffect(A, address(0), address(0), from + 2 * DELAY);
        inEffect(B, address(0), address(0), 0);
        refused(A, "self");
        authros.nameRecovery(A);
        refused(STRANGER, "unregistered");
        authros.nameRecovery(FRIEND);
    }

    function test_a_thief_who_names_a_recovery_account_of_his_own_comes_too_late() public {
        name(A, FRIEND);
        vm.warp(1000 + DELAY);
        name(A, THIEF);
        by(ADMIN);
        authros.proposeSuccession(A, B);
        vm.warp(1000 + 2 * DELAY);
        refused(THIEF, "recovery");
        authros.cancelSuccession(A);
        by(ADMIN);
        authros.completeSuccession(A);
        name(B, FRIEND);
        by(ADMIN);
        authros.proposeSuccession(B, C);
        (, uint64 due, address recovery) = authros.proposalOf(B);
        vm.assertEq(recovery, address(0), "not in effect");
        vm.assertEq(due, block.timestamp + 2 * DELAY, "twice the delay");
        vm.warp(block.timestamp + DELAY);
        refused(FRIEND, "recovery");
        authros.cancelSuccession(B);
    }

    function test_successors_are_registered_unsuspended_and_form_no_circle() public {
        refused(ADMIN, "self");
        authros.proposeSuccession(A, A);
        refused(ADMIN, "unregistered");
        authros.proposeSuccession(A, STRANGER);
        refused(ADMIN, "unregistered");
        authros.proposeSuccession(STRANGER, A);
        by(ADMIN);
        authros.proposeSuccession(A, B);
        by(ADMIN);
        authros.proposeSuccession(B, A);
        vm.warp(1000 + 2 * DELAY);
        by(ADMIN);
        authros.completeSuccession(A);
        refused(ADMIN, "successor");
        authros.completeSuccession(B);
        refused(ADMIN, "successor");
        authros.proposeSuccession(C, A);
        vm.assertEq(authros.successorOf(B), address(0), "the last has none");
    }

    function test_a_pause_ends_by_itself_and_the_next_must_wait() public {
        vm.assertEq(authros.pausedUntil(), 0, "never");
        refused(ADMIN, "unchanged");
        authros.resume();
        refused(ADMIN, "pause");
        authros.pause(1000);
        refused(ADMIN, "pause");
        authros.pause(1000 + 3 days + 1);
        by(ADMIN);
        authros.pause(1000 + 3 days);
        emitted("PausedUntil(uint64)", "", abi.encode(uint64(1000 + 3 days)));
        vm.assertEq(authros.paused(), true, "paused");
        refused(ADMIN, "gap");
        authros.pause(1000 + 3 days);
        vm.warp(1000 + 3 days - 1);
        refused(A, "paused");
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "7");
        vm.warp(1000 + 3 days);
        vm.assertEq(authros.paused(), false, "over");
        upload(A, 1, 0xa1);
        refused(ADMIN, "unchanged");
        authros.resume();
        vm.warp(1000 + 10 days - 1);
        refused(ADMIN, "gap");
        authros.pause(uint64(block.timestamp) + 1);
        vm.warp(1000 + 10 days);
        by(ADMIN);
        authros.pause(uint64(block.timestamp) + 10);
    }

    function test_a_pause_that_was_ended_early_counts_until_then() public {
        by(ADMIN);
        authros.pause(2000);
        vm.warp(1100);
        by(ADMIN);
        authros.resume();
        emitted("PausedUntil(uint64)", "", abi.encode(uint64(1100)));
        vm.assertEq(authros.paused(), false, "goes on");
        vm.warp(1099 + 7 days);
        refused(ADMIN, "gap");
        authros.pause(1100 + 7 days);
        vm.warp(1100 + 7 days);
        by(ADMIN);
        authros.pause(1101 + 7 days);
    }

    function name(address owner, address recovery) private {
        by(owner);
        authros.nameRecovery(recovery);
    }

    function inEffect(address owner, address expected, address last, uint64 since) private view {
        (address recovery, address next, uint64 from) = authros.recoveryOf(owner);
        vm.assertEq(recovery, expected, "in effect");
        vm.assertEq(next, last, "named last");
        vm.assertEq(from, since, "from");
    }
}
