// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Vm} from "./Vm.sol";
import {World} from "./World.sol";

contract AdministratorTest is World {
    function test_who_deploys_administers() public {
        vm.recordLogs();
        AuthROS closed = deploy(false);
        Vm.Log[] memory logs = vm.getRecordedLogs();
        vm.assertEq(logs.length, 3, "events");
        bytes32 changed = keccak256("AdministratorChanged(address,address)");
        vm.assertEq(abi.encodePacked(logs[0].topics), abi.encode(changed, address(0), ADMIN), "administrator");
        vm.assertEq(abi.encodePacked(logs[1].topics), abi.encode(keccak256("OpenChanged(bool)")), "open");
        vm.assertEq(logs[1].data, abi.encode(false), "closed");
        vm.assertEq(abi.encodePacked(logs[2].topics), abi.encode(keccak256("DelayFixed(uint64)")), "delay");
        vm.assertEq(logs[2].data, abi.encode(DELAY), "delay");
        vm.assertEq(closed.delay(), DELAY, "delay");
        vm.assertEq(closed.administrator(), ADMIN, "administrator");
        vm.assertEq(closed.open(), false, "closed");
        vm.assertEq(authros.open(), true, "open");
        vm.assertEq(authros.paused(), false, "paused");
        vm.assertEq(authros.nominee(), address(0), "nominee");
    }

    function test_nobody_else_administers() public {
        address[2] memory others = [A, STRANGER];
        for (uint256 index = 0; index < others.length; index++) {
            address other = others[index];
            refused(other, "administrator");
            authros.admit(other);
            refused(other, "administrator");
            authros.setOpen(false);
            refused(other, "administrator");
            authros.suspend(B);
            refused(other, "administrator");
            authros.restore(B);
            refused(other, "administrator");
            authros.dismiss(B);
            refused(other, "administrator");
            authros.pause(1001);
            refused(other, "administrator");
            authros.resume();
            refused(other, "administrator");
            authros.proposeSuccession(B, C);
            refused(other, "administrator");
            authros.nominate(other);
        }
    }

    function test_the_administrator_changes_nobodys_data() public {
        refused(ADMIN, "unregistered");
        authros.rotate(bytes32(uint256(0xa2)), "");
        refused(ADMIN, "unregistered");
        authros.authorityRevoke(B, bytes32(uint256(0xa2)), "");
        refused(ADMIN, "unregistered");
        authros.authorityGrant(B, 1, 0, topics(0), "envelope");
        vm.assertEq(mayRead(ADMIN, 0xa1, A), false, "reads");
    }

    function test_admitting_and_opening_are_told_and_done_once() public {
        by(ADMIN);
        authros.admit(STRANGER);
        emitted("Admitted(address)", abi.encode(STRANGER), "");
        vm.assertEq(authros.admitted(STRANGER), true, "admitted");
        refused(ADMIN, "unchanged");
        authros.admit(STRANGER);
        refused(ADMIN, "unchanged");
        authros.setOpen(true);
        by(ADMIN);
        authros.setOpen(false);
        emitted("OpenChanged(bool)", "", abi.encode(false));
        vm.assertEq(authros.open(), false, "open");
    }

    function test_an_admission_is_withdrawn() public {
        by(ADMIN);
        authros.setOpen(false);
        refused(ADMIN, "unchanged");
        authros.dismiss(STRANGER);
        by(ADMIN);
        authros.admit(STRANGER);
        by(ADMIN);
        authros.dismiss(STRANGER);
        emitted("Dismissed(address)", abi.encode(STRANGER), "");
        vm.assertEq(authros.admitted(STRANGER), false, "dismissed");
        refused(STRANGER, "closed");
        authros.register(identity(7, 1), "");
        refused(ADMIN, "unchanged");
        authros.dismiss(STRANGER);
        by(ADMIN);
        authros.admit(STRANGER);
        register(STRANGER, 7);
    }

    function test_suspending_and_restoring_are_told_and_done_once() public {
        refused(ADMIN, "unchanged");
        authros.restore(A);
        by(ADMIN);
        authros.suspend(A);
        emitted("Suspended(address)", abi.encode(A), "");
        vm.assertEq(accountOf(A).suspended, true, "suspended");
        refused(ADMIN, "unchanged");
        authros.suspend(A);
        by(ADMIN);
        authros.restore(A);
        emitted("Restored(address)", abi.encode(A), "");
        vm.assertEq(accountOf(A).suspended, false, "restored");
    }

    function test_handing_over_takes_two_steps() public {
        refused(A, "nominee");
        authros.acceptAdministrator();
        by(ADMIN);
        authros.nominate(A);
        emitted("AdministratorNominated(address)", abi.encode(A), "");
        vm.assertEq(authros.nominee(), A, "nominee");
        refused(B, "nominee");
        authros.acceptAdministrator();
        refused(A, "administrator");
        authros.pause(1001);
        by(A);
        authros.acceptAdministrator();
        emitted("AdministratorChanged(address,address)", abi.encode(ADMIN, A), "");
        vm.assertEq(authros.administrator(), A, "administrator");
        vm.assertEq(authros.nominee(), address(0), "nominee");
        refused(A, "nominee");
        authros.acceptAdministrator();
        refused(ADMIN, "administrator");
        authros.pause(1001);
        by(A);
        authros.pause(1001);
    }

    function test_a_nomination_is_withdrawn() public {
        by(ADMIN);
        authros.nominate(A);
        by(ADMIN);
        authros.nominate(address(0));
        refused(A, "nominee");
        authros.acceptAdministrator();
    }

    function test_a_pause_stops_all_but_what_takes_rights_away() public {
        prepare();
        by(ADMIN);
        authros.pause(1001);
        stopped("paused");
        refused(STRANGER, "paused");
        authros.register(identity(7, 1), "");
        goesOn();
        by(ADMIN);
        authros.resume();
        upload(A, 1, 0xa1);
    }

    function test_a_suspension_stops_all_but_what_takes_rights_away() public {
        prepare();
        by(ADMIN);
        authros.suspend(A);
        stopped("suspended");
        goesOn();
        by(ADMIN);
        authros.restore(A);
        upload(A, 1, 0xa1);
        by(ADMIN);
        authros.suspend(STRANGER);
        refused(STRANGER, "suspended");
        authros.register(identity(7, 1), "");
    }

    function prepare() private {
        grant(A, B, 1);
        by(A);
        authros.lend(bytes32(uint256(0xd)), 0);
    }

    function stopped(string memory reason) private {
        refused(A, reason);
        authros.dataUpload(abi.encode(uint256(1)), abi.encode(uint256(0xa1)), "7");
        refused(A, reason);
        authros.authorityGrant(C, 1, 0, topics(0), "envelope");
        refused(A, reason);
        authros.wrap(only(B), 1, only("envelope"));
        refused(A, reason);
        authros.anchor(bytes32(uint256(1)), 5, bytes32(0));
        refused(A, reason);
        authros.lend(bytes32(uint256(0xe)), 0);
        refused(A, reason);
        authros.rotateKeys(identity(0xa1, 2), "");
        refused(A, reason);
        authros.extend(B, 0);
        refused(A, reason);
        authros.nameRecovery(B);
    }

    function goesOn() private {
        vm.assertEq(mayRead(A, 0xa1, A), true, "the owner reads");
        vm.assertEq(mayRead(B, 0xa1, A), true, "the grantee reads");
        vm.assertEq(accountOf(A).epoch, 1, "the account is read");
        by(A);
        authros.recall(bytes32(uint256(0xd)));
        rotate(A, 0xa2);
        revoke(A, B, 0xa3);
        vm.assertEq(mayRead(B, 0xa1, A), false, "no longer");
    }
}
