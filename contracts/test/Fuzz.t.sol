// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

import {World} from "./World.sol";

/// @dev What holds for any input. Names begin with testFuzz, so that forge can tell them from the fixed ones.
contract FuzzTest is World {
    function testFuzz_an_identity_is_taken_where_it_has_224_bytes_and_a_token(bytes memory text, bool whole) public {
        if (whole) text = abi.encodePacked(keccak256(text), filled(192, uint8(text.length)));
        bool due = text.length == 224;
        vm.prank(STRANGER);
        (bool done,) = address(authros).call(abi.encodeWithSelector(authros.register.selector, text, ""));
        vm.assertEq(done, due, "registered");
        vm.assertEq(accountOf(STRANGER).identity, due ? text : bytes(""), "identity");
        vm.assertEq(accountOf(STRANGER).epoch, due ? 1 : 0, "epoch");
    }

    function testFuzz_an_upload_is_taken_where_its_lengths_are_right(
        bytes32 digest,
        uint8 first,
        uint8 second,
        uint8 third
    ) public {
        uint256[3] memory lengths = [near(first), near(second), near(third)];
        bytes memory whole = abi.encodePacked(digest, digest);
        bytes memory token = abi.encodePacked(bytes32(uint256(0xa1)), bytes32(0));
        bytes memory data = abi.encodeWithSelector(
            authros.dataUpload.selector, cut(whole, lengths[0]), cut(token, lengths[1]), filled(lengths[2], 1)
        );
        bool due = lengths[0] == 32 && lengths[1] == 32 && lengths[2] <= 32;
        vm.prank(A);
        (bool done,) = address(authros).call(data);
        vm.assertEq(done, due, "uploaded");
        vm.assertEq(authros.uploadedAt(A, digest), due ? 1 : 0, "block");
        vm.assertEq(accountOf(A).count, due ? 1 : 0, "count");
        vm.prank(A);
        (done,) = address(authros).call(data);
        vm.assertEq(done, false, "uploaded twice");
    }

    function testFuzz_epochs_follow_the_tokens(bytes32[8] memory tokens) public {
        uint64 epoch = 1;
        for (uint256 index = 0; index < tokens.length; index++) {
            bool due = tokens[index] != 0 && authros.epochOf(A, tokens[index]) == 0;
            vm.prank(A);
            (bool done,) = address(authros).call(abi.encodeWithSelector(authros.rotate.selector, tokens[index], ""));
            vm.assertEq(done, due, "rotated");
            if (due) epoch += 1;
            vm.assertEq(accountOf(A).epoch, epoch, "epoch");
            if (due) vm.assertEq(authros.epochOf(A, tokens[index]), epoch, "epoch of the token");
        }
    }

    function testFuzz_a_grant_holds_until_its_end(uint64 expiry, uint64 granted, uint64 asked) public {
        granted %= 1 << 40;
        expiry %= 1 << 41;
        asked = granted + asked % (1 << 41);
        vm.warp(granted);
        bool due = expiry == 0 || expiry > granted;
        vm.prank(A);
        bytes memory data =
            abi.encodeWithSelector(authros.authorityGrant.selector, B, 1, expiry, topics(0), bytes("envelope"));
        (bool done,) = address(authros).call(data);
        vm.assertEq(done, due, "granted");
        vm.warp(asked);
        vm.assertEq(mayRead(B, 0xa1, A), due && (expiry == 0 || asked < expiry), "authorised");
    }

    function testFuzz_a_grant_is_only_ever_lengthened(uint64 expiry, uint64 longer, uint64 asked) public {
        expiry = 1001 + expiry % 1000;
        by(A);
        authros.authorityGrant(B, 1, expiry, topics(0), "envelope");
        vm.warp(1000 + asked % 1500);
        bool due = block.timestamp < expiry && (longer == 0 || longer > expiry);
        vm.prank(A);
        (bool done,) = address(authros).call(abi.encodeWithSelector(authros.extend.selector, B, longer));
        vm.assertEq(done, due, "extended");
        (,, uint64 kept,,) = authros.grantOf(A, B);
        vm.assertEq(kept, due ? longer : expiry, "expiry");
    }

    function testFuzz_a_grant_covers_its_epoch_and_the_later_ones(uint8 epochs, uint8 from) public {
        uint64 last = uint64(epochs % 10) + 1;
        uint64 first = uint64(from) % (last + 2);
        for (uint256 epoch = 2; epoch <= last; epoch++) {
            rotate(A, 0xa0 + epoch);
        }
        vm.prank(A);
        bytes memory data =
            abi.encodeWithSelector(authros.authorityGrant.selector, B, first, 0, topics(0), bytes("envelope"));
        (bool done,) = address(authros).call(data);
        vm.assertEq(done, first >= 1 && first <= last, "granted");
        rotate(A, 0xff);
        for (uint256 epoch = 1; epoch <= last; epoch++) {
            vm.assertEq(mayRead(B, 0xa0 + epoch, A), done && epoch >= first, "of an epoch");
        }
        vm.assertEq(mayRead(B, 0xff, A), done, "of the epoch to come");
    }

    function testFuzz_a_scope_is_kept_as_its_hash(bytes16[] memory scope) public {
        if (scope.length > 40) scope = topics(scope.length % 41);
        vm.prank(A);
        (bool done,) = address(authros)
            .call(abi.encodeWithSelector(authros.authorityGrant.selector, B, 1, 0, scope, bytes("envelope")));
        vm.assertEq(done, scope.length <= 32, "granted");
        bytes memory ids = "";
        for (uint256 index = 0; index < scope.length; index++) {
            ids = abi.encodePacked(ids, bytes32(scope[index]));
        }
        (,,,, bytes32 kept) = authros.grantOf(A, B);
        vm.assertEq(kept, done && ids.length != 0 ? keccak256(ids) : bytes32(0), "scope");
    }

    function testFuzz_an_anchor_follows_the_head(bytes32[5] memory roots, bytes32 wrong, uint64 count) public {
        bytes32 head = 0;
        for (uint256 index = 0; index < roots.length; index++) {
            if (wrong != head) {
                refused(A, roots[index] == 0 || roots[index] == ~bytes32(0) || count == 0 ? "empty" : "previous");
                authros.anchor(roots[index], count, wrong);
            }
            vm.prank(A);
            (bool done,) =
                address(authros).call(abi.encodeWithSelector(authros.anchor.selector, roots[index], count, head));
            vm.assertEq(done, roots[index] != 0 && roots[index] != ~bytes32(0) && count != 0, "anchored");
            if (done) head = roots[index];
            vm.assertEq(authros.headOf(A), head, "head");
        }
    }

    /// @dev Whatever B sends, A's state stays, and so does the administrator's. A has granted and lent to B.
    function testFuzz_nobody_acts_for_another(
        uint8 act,
        bytes32 first,
        bytes32 second,
        bytes32 third,
        bytes memory tail
    ) public {
        grant(A, B, 1);
        upload(A, 5, 0xa1);
        by(A);
        authros.lend(bytes32(uint256(0xd)), 0);
        bytes32 before = stateOfA();
        bytes4[25] memory acts = selectors();
        if (act % 3 == 0) first = bytes32(uint256(uint160(A)));
        if (act % 3 == 1) (first, second) = (bytes32(uint256(uint160(C))), bytes32(uint256(uint160(A))));
        bytes4 chosen = acts[act % acts.length];
        bytes memory data = chosen == authros.rotate.selector
            ? abi.encodeWithSelector(chosen, first, tail)
            : abi.encodePacked(chosen, first, second, third, tail);
        vm.prank(B);
        (bool done,) = address(authros).call(data);
        vm.assertEq(stateOfA(), before, "as before");
        if (chosen == authros.rotate.selector) {
            bool due = first != bytes32(uint256(0xb1)) && first != 0 && tail.length <= authros.LONGEST_ENVELOPE();
            vm.assertEq(done, due, "B's own");
        }
    }

    function stateOfA() private returns (bytes32) {
        (bool active, uint64 epoch, uint64 expiry, uint64 revokes, bytes32 scope) = authros.grantOf(A, B);
        (bool lent, uint64 until,,) = authros.loanOf(A, bytes32(uint256(0xd)));
        (uint64 given, uint64 keys) = authros.envelopeOf(A, B, 1);
        bytes memory grants = abi.encode(active, epoch, expiry, revokes, scope, lent, until, given, keys);
        bytes memory chief = abi.encode(
            authros.administrator(), authros.nominee(), authros.open(), authros.paused(), authros.successorOf(A)
        );
        (address recovery, address next,) = authros.recoveryOf(A);
        (, uint64 due,) = authros.proposalOf(A);
        chief = abi.encode(chief, recovery, next, due);
        bytes memory own = abi.encode(
            accountOf(A), authros.headOf(A), authros.uploadedAt(A, bytes32(uint256(5))), mayRead(C, 0xa1, A)
        );
        return keccak256(abi.encode(grants, chief, own));
    }

    function selectors() private view returns (bytes4[25] memory) {
        return [
            authros.register.selector,
            authros.rotateKeys.selector,
            authros.rotate.selector,
            authros.dataUpload.selector,
            authros.anchor.selector,
            authros.authorityGrant.selector,
            authros.wrap.selector,
            authros.authorityRevoke.selector,
            authros.lend.selector,
            authros.recall.selector,
            authros.admit.selector,
            authros.setOpen.selector,
            authros.suspend.selector,
            authros.restore.selector,
            authros.dismiss.selector,
            authros.pause.selector,
            authros.resume.selector,
            authros.extend.selector,
            authros.nameRecovery.selector,
            authros.proposeSuccession.selector,
            authros.cancelSuccession.selector,
            authros.completeSuccession.selector,
            authros.nominate.selector,
            authros.acceptAdministrator.selector,
            bytes4(0x01020304)
        ];
    }

    /// @dev Half of the time 32, otherwise up to 63.
    function near(uint8 seed) private pure returns (uint256) {
        return seed % 2 == 0 ? 32 : (seed / 2) % 64;
    }

    function cut(bytes memory text, uint256 length) private pure returns (bytes memory part) {
        part = new bytes(length);
        for (uint256 index = 0; index < length; index++) {
            part[index] = text[index];
        }
    }
}
