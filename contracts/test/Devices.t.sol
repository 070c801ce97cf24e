// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {World} from "./World.sol";

contract DevicesTest is World {
    bytes32 private constant DEVICE = bytes32(uint256(0xd));

    function test_a_device_is_lent_and_recalled() public {
        vm.roll(70);
        by(A);
        authros.lend(DEVICE, 2000);
        emitted("Lent(address,bytes32,uint64)", abi.encode(A, DEVICE), abi.encode(uint64(2000)));
        (bool active, uint64 until, uint64 lentAt, uint64 recalledAt) = authros.loanOf(A, DEVICE);
        vm.assertEq(active, true, "lent");
        vm.assertEq(until, 2000, "until");
        vm.assertEq(lentAt, 70, "since");
        vm.assertEq(recalledAt, 0, "not recalled");
        (active,,,) = authros.loanOf(B, DEVICE);
        vm.assertEq(active, false, "for nobody else");
        vm.roll(71);
        by(A);
        authros.recall(DEVICE);
        emitted("Recalled(address,bytes32)", abi.encode(A, DEVICE), "");
        (active, until, lentAt, recalledAt) = authros.loanOf(A, DEVICE);
        vm.assertEq(active, false, "recalled");
        vm.assertEq(lentAt, 70, "when it was lent");
        vm.assertEq(recalledAt, 71, "when it was recalled");
        by(A);
        authros.lend(DEVICE, 0);
        (active, until, lentAt, recalledAt) = authros.loanOf(A, DEVICE);
        vm.assertEq(active, true, "lent again");
        vm.assertEq(recalledAt, 0, "and not recalled since");
        vm.assertEq(until, 0, "without end");
    }

    function test_a_loan_ends_in_the_future_and_names_a_device() public {
        refused(A, "empty");
        authros.lend(bytes32(0), 0);
        refused(A, "expired");
        authros.lend(DEVICE, 1000);
        refused(STRANGER, "unregistered");
        authros.lend(DEVICE, 0);
        by(A);
        authros.lend(DEVICE, 1001);
    }

    function test_only_the_lender_recalls_and_only_what_is_lent() public {
        refused(A, "no loan");
        authros.recall(DEVICE);
        by(A);
        authros.lend(DEVICE, 1001);
        refused(B, "no loan");
        authros.recall(DEVICE);
        refused(STRANGER, "unregistered");
        authros.recall(DEVICE);
        vm.warp(3000);
        by(A);
        authros.recall(DEVICE);
        refused(A, "no loan");
        authros.recall(DEVICE);
    }
}
