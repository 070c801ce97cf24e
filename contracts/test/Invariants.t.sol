// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {AuthROS} from "../AuthROS.sol";
import {Crowd} from "./Crowd.sol";
import {Cheats} from "./Vm.sol";

/// @dev What holds whatever the crowd does. That nobody acts for another, that grants come from their owner, that the
///      epoch only grows and digests are unique is asserted by the crowd at each act (see Crowd.act and Mirror.take).
contract InvariantsTest is Cheats {
    struct FuzzSelector {
        address target;
        bytes4[] selectors;
    }

    Crowd private crowd;
    AuthROS private authros;

    function setUp() public {
        crowd = new Crowd();
        authros = crowd.authros();
    }

    /// @dev Forge asks this and the next: only the crowd acts.
    function targetContracts() external view returns (address[] memory targets) {
        targets = new address[](1);
        targets[0] = address(crowd);
    }

    function targetSelectors() external view returns (FuzzSelector[] memory targets) {
        targets = new FuzzSelector[](1);
        targets[0] = FuzzSelector(address(crowd), acts());
    }

    function invariant_the_state_read_is_the_state_rebuilt_from_the_events() public view {
        crowd.compare();
    }

    function invariant_only_owners_and_standing_grantees_are_authorised() public {
        crowd.readAll();
    }

    function invariant_nobody_is_blocked_and_rights_can_always_be_taken_away() public {
        for (uint256 index = 0; index < crowd.population(); index++) {
            address person = crowd.person(index);
            if (crowd.epochOf(person, tokenOf(person)) == 0) continue;
            uint256 before = vm.snapshotState();
            takesRightsAway(person);
            if (crowd.acting(person)) goesOnWorking(person, crowd.person(index + 1));
            vm.assertTrue(vm.revertToState(before), "as before");
        }
    }

    /// @dev Whether paused or suspended.
    function takesRightsAway(address person) private {
        for (uint256 other = 0; other < crowd.population(); other++) {
            address reader = crowd.person(other);
            (bool active,,,,) = authros.grantOf(person, reader);
            if (!active) continue;
            vm.prank(person);
            authros.authorityRevoke(reader, keccak256(abi.encode("revoke", other)), "");
            vm.prank(reader);
            (bool authorised,,,) = authros.dataQuery(abi.encode(tokenOf(person)), person);
            vm.assertEq(authorised, false, "revoked");
        }
        for (uint256 device = 0; device < crowd.WORDS(); device++) {
            (bool active,,,) = authros.loanOf(person, bytes32(device));
            if (!active) continue;
            vm.prank(person);
            authros.recall(bytes32(device));
        }
        vm.prank(person);
        authros.rotate(keccak256("rotate"), "");
        vm.assertEq(tokenOf(person), keccak256("rotate"), "rotated");
    }

    /// @dev Whatever the others did.
    function goesOnWorking(address person, address other) private {
        bytes memory token = abi.encode(tokenOf(person));
        vm.prank(person);
        authros.dataUpload(abi.encode(keccak256("digest")), token, "");
        bytes32 head = authros.headOf(person);
        vm.prank(person);
        authros.anchor(keccak256("root"), 1, head);
        vm.prank(person);
        authros.lend(keccak256("device"), 0);
        if (tokenOf(other) == 0) return;
        (, uint64 epoch,,,,,) = authros.accountOf(person);
        vm.prank(person);
        authros.authorityGrant(other, epoch, 0, new bytes16[](0), "envelope");
    }

    function tokenOf(address person) private view returns (bytes32 token) {
        (,, token,,,,) = authros.accountOf(person);
    }

    /// @dev The crowd is not idle: in a long fixed run each act is done and refused, and the state is as rebuilt.
    function test_the_crowd_does_and_is_refused_each_act() public {
        bytes4[] memory all = acts();
        uint256 seed = 0;
        for (uint256 step = 0; step < 1500; step++) {
            seed = uint256(keccak256(abi.encode(seed)));
            bytes memory data = abi.encodePacked(
                all[seed % all.length],
                shortened(seed, 16),
                shortened(seed, 32),
                shortened(seed, 48),
                shortened(seed, 64),
                shortened(seed, 80)
            );
            (bool done,) = address(crowd).call(data);
            vm.assertTrue(done, "as foretold");
        }
        crowd.compare();
        crowd.readAll();
        for (uint256 index = 0; index < all.length; index++) {
            if (all[index] == crowd.passTime.selector) continue;
            vm.assertEq(crowd.doneOf(all[index]) > 0 ? 99 : index, 99, "done");
            vm.assertTrue(crowd.refusedOf(all[index]) > 0, "refused");
        }
    }

    function shortened(uint256 seed, uint256 bits) private pure returns (uint256) {
        return (seed >> bits) % 4096;
    }

    function acts() private view returns (bytes4[] memory all) {
        all = new bytes4[](25);
        all[0] = crowd.register.selector;
        all[1] = crowd.rotateKeys.selector;
        all[2] = crowd.rotate.selector;
        all[3] = crowd.dataUpload.selector;
        all[4] = crowd.anchor.selector;
        all[5] = crowd.lend.selector;
        all[6] = crowd.recall.selector;
        all[7] = crowd.authorityGrant.selector;
        all[8] = crowd.wrap.selector;
        all[9] = crowd.authorityRevoke.selector;
        all[10] = crowd.admit.selector;
        all[11] = crowd.setOpen.selector;
        all[12] = crowd.pause.selector;
        all[13] = crowd.suspend.selector;
        all[14] = crowd.restore.selector;
        all[15] = crowd.proposeSuccession.selector;
        all[16] = crowd.nominate.selector;
        all[17] = crowd.acceptAdministrator.selector;
        all[18] = crowd.passTime.selector;
        all[19] = crowd.resume.selector;
        all[20] = crowd.dismiss.selector;
        all[21] = crowd.nameRecovery.selector;
        all[22] = crowd.extend.selector;
        all[23] = crowd.cancelSuccession.selector;
        all[24] = crowd.completeSuccession.selector;
    }
}
