// SPDX-License-Identifier: Apache-2.0
pragma solidity >=0.7.6 <0.9.0;
pragma abicoder v2;

/// @title AuthROS: identities, digests, grants and anchors of robot data under proof
/// @notice Who may read whose robot data, and which data existed when. No key, name or plaintext ever
///         enters this contract; secrecy comes from encryption alone, and every view is public.
/// @dev msg.sender is the identity. No ether, no external call, no upgrade, no loop over anything that
///      an outsider can grow. Every change emits an event, and all state can be rebuilt from the events.
///      Times are seconds since 1970. Acts that only take rights away (authorityRevoke, rotate, recall)
///      and reads are never stopped by a pause or a suspension; nor is a recovery account's veto.
///      The administrator is bounded: a succession waits, a pause ends, an admission can be withdrawn.
///      For proofs of storage the layout stays as it is; contracts/README.md lists the slots.
contract AuthROS {
    /// @dev One registered account. `epoch` 0 means that it is not registered.
    struct Account {
        uint64 epoch;
        uint64 count;
        uint64 keys;
        bool suspended;
        bytes32 token;
        bytes32 last;
        bytes identity;
    }

    /// @dev What an owner granted one account, and how often it was revoked before. `scope` is zero for all
    ///      topics, else the Keccak-256 of the topic ids, each filled up with zeros to 32 bytes.
    struct Grant {
        bool active;
        uint64 epoch;
        uint64 expiry;
        uint64 revokes;
        bytes32 scope;
    }

    /// @dev An envelope given: after how many revokes, and for which version of the grantee's keys (0: none given).
    struct Envelope {
        uint64 revokes;
        uint64 keys;
    }

    /// @dev A root anchored by an account: block and time of its first anchoring, the number of leaves, and the version
    ///      of the account's keys then.
    struct Anchor {
        uint64 blockNumber;
        uint64 count;
        uint64 time;
        uint64 keys;
    }

    /// @dev A device that may sign for its owner; `until` 0 means without end. `lentAt` and `recalledAt` are blocks;
    ///      `recalledAt` 0 means that it was not recalled since.
    struct Loan {
        bool active;
        uint64 until;
        uint64 lentAt;
        uint64 recalledAt;
    }

    /// @dev One version of an account's keys: the Keccak-256 of its identity, and since when it stands.
    struct Keys {
        bytes32 identity;
        uint64 blockNumber;
        uint64 time;
    }

    /// @dev Who may stop a succession: `current` until `from`, `next` from then on; `from` 0 means that none was named.
    struct Recovery {
        address current;
        uint64 from;
        address next;
    }

    /// @dev A succession that waits: it can be completed from `due` on; `due` 0 means that there is none. `recovery` is
    ///      who may stop it, the account that was in effect when it was proposed.
    struct Proposal {
        address successor;
        uint64 due;
        address recovery;
    }

    /// @notice Length of an identity: token (32) || P_C (64) || P_E (64) || proof (64).
    uint256 public constant IDENTITY_LENGTH = 224;
    /// @notice The most topics in the scope of a grant.
    uint256 public constant MOST_TOPICS = 32;
    /// @notice The most grantees in one call of wrap.
    uint256 public constant MOST_WRAPS = 32;
    /// @notice The longest envelope, bytes.
    uint256 public constant LONGEST_ENVELOPE = 4096;
    /// @notice The longest capture time given with a digest, bytes.
    uint256 public constant LONGEST_TIMESTAMP = 32;
    /// @notice The shortest delay of a succession that a contract can be deployed with, seconds.
    uint64 public constant SHORTEST_DELAY = 1 days;
    /// @notice The longest one, seconds.
    uint64 public constant LONGEST_DELAY = 365 days;
    /// @notice The longest pause, seconds.
    uint64 public constant LONGEST_PAUSE = 3 days;
    /// @notice How long changes must have gone on before the next pause, seconds.
    uint64 public constant SHORTEST_GAP = 7 days;

    /// @notice Who admits, suspends, pauses and proposes successors.
    address public administrator;
    /// @notice Who was named as the next administrator and has not accepted yet.
    address public nominee;
    /// @notice Whether anyone may register.
    bool public open;
    /// @notice Until when changes are stopped, or were last; 0 where they never were.
    uint64 public pausedUntil;
    /// @notice Who may register while registration is closed.
    mapping(address => bool) public admitted;
    /// @notice Who continues the work of a lost account.
    mapping(address => address) public successorOf;
    /// @notice The epoch of an owner's token; 0 where the owner never registered it.
    mapping(address => mapping(bytes32 => uint64)) public epochOf;
    /// @notice The block in which an owner uploaded a digest; 0 where it was not.
    mapping(address => mapping(bytes32 => uint64)) public uploadedAt;
    /// @notice What an owner granted to an account.
    mapping(address => mapping(address => Grant)) public grantOf;
    /// @notice The envelope that an owner gave a grantee for an epoch.
    mapping(address => mapping(address => mapping(uint64 => Envelope))) public envelopeOf;
    /// @notice When an account first anchored a root, over how many leaves, and with which version of its keys.
    mapping(address => mapping(bytes32 => Anchor)) public anchorOf;
    /// @notice Whether an owner lends a device its signature.
    mapping(address => mapping(bytes32 => Loan)) public loanOf;

    /// @dev Stands for "no root yet" in `heads`: a word that is not zero is cheaper to replace.
    bytes32 private constant NO_ROOT = bytes32(type(uint256).max);

    mapping(address => Account) private accounts;
    /// @dev Written at registration already, so that the first anchor costs what each further one does.
    mapping(address => bytes32) private heads;
    mapping(address => Recovery) private recoveries;

    /// @notice How long a succession waits where the lost account has a recovery account, else twice as long; seconds.
    /// @dev Written by the constructor alone. Not immutable, so that all contracts have the same code.
    uint64 public delay;
    /// @notice The succession that was proposed for an account and waits.
    mapping(address => Proposal) public proposalOf;
    /// @notice Each version of an account's keys, from 1 on.
    mapping(address => mapping(uint64 => Keys)) public keysOf;

    /// @notice An account registered; it stands at epoch 1.
    event Registered(address indexed owner, bytes32 indexed token, bytes identity);
    /// @notice An account replaced its SM2 keys; the envelope hands them to whoever has the account's earlier ones.
    event KeysRotated(address indexed owner, uint64 keys, bytes identity, bytes envelope);
    /// @notice A digest was uploaded: the owner's `number`-th, sealed in `epoch`.
    event DataUploaded(
        address indexed owner,
        bytes32 indexed digest,
        bytes32 indexed token,
        uint64 epoch,
        uint64 number,
        bytes timestamp
    );
    /// @notice An owner lets a grantee read; an empty scope means all topics, expiry 0 no end.
    event Granted(
        address indexed owner, address indexed grantee, uint64 epoch, uint64 expiry, bytes16[] scope, bytes envelope
    );
    /// @notice A grantee got the envelope of a further epoch; or an owner, who is the grantee then, that of a new epoch.
    event Wrapped(address indexed owner, address indexed grantee, uint64 epoch, bytes envelope);
    /// @notice A grant ended, and with it the epoch: `epoch` and `token` are the new ones.
    event Revoked(address indexed owner, address indexed grantee, uint64 epoch, bytes32 token);
    /// @notice An epoch ended without a revoke: `epoch` and `token` are the new ones.
    event Rotated(address indexed owner, uint64 epoch, bytes32 token);
    /// @notice A Merkle root over `count` digests was anchored after `previous`.
    event Anchored(address indexed account, bytes32 indexed root, uint64 count, bytes32 previous);
    /// @notice A grant ends later than it did, and goes on otherwise unchanged; expiry 0 means no end.
    event Extended(address indexed owner, address indexed grantee, uint64 expiry);
    /// @notice An owner named who may stop a succession of its account, from a time on; zero means nobody.
    event RecoveryNamed(address indexed owner, address indexed recovery, uint64 from);
    /// @notice A device may sign for its owner; until 0 means without end.
    event Lent(address indexed owner, bytes32 indexed device, uint64 until);
    /// @notice A device may no longer sign for its owner.
    event Recalled(address indexed owner, bytes32 indexed device);
    /// @notice The administrator let an account register.
    event Admitted(address indexed account);
    /// @notice The administrator withdrew an admission.
    event Dismissed(address indexed account);
    /// @notice Registration was opened to all, or closed.
    event OpenChanged(bool open);
    /// @notice An account may make no more changes but those that take rights away.
    event Suspended(address indexed account);
    /// @notice A suspended account is free again.
    event Restored(address indexed account);
    /// @notice Changes are stopped until a time; one that has come means that they go on.
    event PausedUntil(uint64 until);
    /// @notice A successor is proposed for a lost account; it takes effect by completion, from a time on.
    event SuccessionProposed(address indexed lost, address indexed successor, address recovery, uint64 due);
    /// @notice A succession that waited was stopped by the recovery account, or withdrawn by the administrator.
    event SuccessionCancelled(address indexed lost, address indexed by);
    /// @notice A lost account is suspended for good, and another continues its work.
    event Succeeded(address indexed lost, address indexed successor);
    /// @notice The administrator named a next one.
    event AdministratorNominated(address indexed nominee);
    /// @notice The administrator changed.
    event AdministratorChanged(address indexed previous, address indexed administrator);
    /// @notice How long a succession waits here, seconds; emitted once, by the constructor.
    event DelayFixed(uint64 delay);

    modifier onlyAdministrator() {
        require(msg.sender == administrator, "administrator");
        _;
    }

    /// @dev The sender is registered.
    modifier registered() {
        require(accounts[msg.sender].epoch != 0, "unregistered");
        _;
    }

    /// @dev The sender may change things: registered, not suspended, contract not paused.
    modifier acting() {
        require(!paused(), "paused");
        require(accounts[msg.sender].epoch != 0, "unregistered");
        require(!accounts[msg.sender].suspended, "suspended");
        _;
    }

    /// @param open_ whether anyone may register, or only whom the administrator admits
    /// @param delay_ how long a succession waits, seconds; between a day and a year
    constructor(bool open_, uint64 delay_) {
        require(delay_ >= SHORTEST_DELAY && delay_ <= LONGEST_DELAY, "delay");
        administrator = msg.sender;
        open = open_;
        delay = delay_;
        emit AdministratorChanged(address(0), msg.sender);
        emit OpenChanged(open_);
        emit DelayFixed(delay_);
    }

    // ---- identity ----

    /// @notice Registers the sender at epoch 1.
    /// @dev The SM2 proof cannot be checked here: every client checks it, else the identity counts as unregistered.
    /// @param identity token || P_C || P_E || proof, 224 bytes
    /// @param envelope the epoch's key, wrapped for the sender itself; empty where nothing is sealed under it
    function register(bytes calldata identity, bytes calldata envelope) external {
        Account storage account = accounts[msg.sender];
        require(!paused(), "paused");
        require(!account.suspended, "suspended");
        require(account.epoch == 0, "registered");
        require(open || admitted[msg.sender], "closed");
        bytes32 token = tokenOf(identity);
        setKeys(account, 1, identity);
        heads[msg.sender] = NO_ROOT;
        setToken(account, token);
        emit Registered(msg.sender, token, identity);
        keepEnvelope(1, envelope);
    }

    /// @notice Replaces the sender's SM2 keys; the epoch goes on.
    /// @param identity the current token || new P_C || new P_E || new proof, 224 bytes
    /// @param envelope the new keys, wrapped for the sender's earlier ones
    function rotateKeys(bytes calldata identity, bytes calldata envelope) external acting {
        Account storage account = accounts[msg.sender];
        require(envelope.length <= LONGEST_ENVELOPE, "envelope");
        require(tokenOf(identity) == account.token, "token unknown");
        setKeys(account, account.keys + 1, identity);
        emit KeysRotated(msg.sender, account.keys, identity, envelope);
    }

    /// @notice Ends the sender's epoch and begins the next.
    /// @param newToken the token of the next epoch
    /// @param envelope the next epoch's key, wrapped for the sender itself
    function rotate(bytes32 newToken, bytes calldata envelope) external registered {
        Account storage account = accounts[msg.sender];
        setToken(account, newToken);
        emit Rotated(msg.sender, account.epoch, newToken);
        keepEnvelope(account.epoch, envelope);
    }

    /// @notice Names who may stop a succession of the sender's account. It takes effect after the delay, so that a thief
    ///         of the account gains nothing where the succession is proposed before.
    /// @dev The recovery account need not be registered; no pause or suspension stops its veto.
    /// @param recovery who, another account; the zero address names nobody
    function nameRecovery(address recovery) external acting {
        require(recovery != msg.sender, "self");
        Recovery storage named = recoveries[msg.sender];
        uint64 from = uint64(block.timestamp) + delay;
        named.current = recoveryInEffect(named);
        named.next = recovery;
        named.from = from;
        emit RecoveryNamed(msg.sender, recovery, from);
    }

    // ---- digests ----

    /// @notice Puts the digest of one record on the chain.
    /// @dev Any token that the sender ever registered is accepted: a record sealed before a revoke must not be lost.
    /// @param digest SM3 of the record, 32 bytes; once per owner
    /// @param token of the epoch in which the record was sealed, 32 bytes
    /// @param timestamp when it was captured, as the sender says; at most 32 bytes
    function dataUpload(bytes calldata digest, bytes calldata token, bytes calldata timestamp) external acting {
        require(timestamp.length <= LONGEST_TIMESTAMP, "length");
        bytes32 digestWord = word(digest);
        bytes32 tokenWord = word(token);
        uint64 epoch = epochOf[msg.sender][tokenWord];
        require(epoch != 0, "token unknown");
        require(uploadedAt[msg.sender][digestWord] == 0, "digest used");
        uploadedAt[msg.sender][digestWord] = uint64(block.number);
        Account storage account = accounts[msg.sender];
        uint64 number = account.count + 1;
        account.count = number;
        account.last = digestWord;
        emit DataUploaded(msg.sender, digestWord, tokenWord, epoch, number, timestamp);
    }

    /// @notice Answers whether the caller may read an owner's records of the token's epoch.
    /// @dev The sender of an eth_call is not authenticated, so this guards nothing secret.
    /// @param token a token of the owner, 32 bytes; it selects an epoch
    /// @param owner whose records
    /// @return authorised whether the caller is the owner, or holds a grant that covers the epoch and has not ended
    /// @return epoch of the token; 0 where the owner never registered it
    /// @return count of the owner's digests; 0 where not authorised
    /// @return last digest of the owner; zero where not authorised
    function dataQuery(bytes calldata token, address owner)
        external
        view
        returns (bool authorised, uint64 epoch, uint64 count, bytes32 last)
    {
        epoch = epochOf[owner][word(token)];
        authorised = epoch != 0 && mayRead(owner, msg.sender, epoch);
        if (authorised) {
            count = accounts[owner].count;
            last = accounts[owner].last;
        }
    }

    /// @notice Anchors the Merkle root of a batch, chained to the sender's last one.
    /// @dev The sender attests time and existence; authorship is the SM2 signature in each record.
    ///      Where a root is anchored twice, the earliest counts.
    /// @param root Merkle root, SM3; neither all zeros nor all ones
    /// @param count number of leaves
    /// @param previous the sender's last root, zero for the first
    function anchor(bytes32 root, uint64 count, bytes32 previous) external acting {
        require(root != 0 && root != NO_ROOT && count != 0, "empty");
        require(headOf(msg.sender) == previous, "previous");
        heads[msg.sender] = root;
        if (anchorOf[msg.sender][root].blockNumber == 0) {
            uint64 keys = accounts[msg.sender].keys;
            anchorOf[msg.sender][root] = Anchor(uint64(block.number), count, uint64(block.timestamp), keys);
        }
        emit Anchored(msg.sender, root, count, previous);
    }

    // ---- grants ----

    /// @notice Lets a registered account read the sender's records from an epoch on.
    /// @param grantee who may read
    /// @param epoch the epoch whose key the envelope carries; at most the current one
    /// @param expiry when the grant ends, seconds; 0 means no end
    /// @param scope the topic ids covered; empty means all
    /// @param envelope the wrapped keys
    function authorityGrant(
        address grantee,
        uint64 epoch,
        uint64 expiry,
        bytes16[] calldata scope,
        bytes calldata envelope
    ) external acting {
        require(grantee != msg.sender, "self");
        require(expiry == 0 || expiry > block.timestamp, "expired");
        require(scope.length <= MOST_TOPICS, "scope");
        setWrapped(grantee, epoch, envelope);
        Grant storage grant = grantOf[msg.sender][grantee];
        grant.active = true;
        grant.epoch = epoch;
        grant.expiry = expiry;
        grant.scope = scopeHash(scope);
        emit Granted(msg.sender, grantee, epoch, expiry, scope, envelope);
    }

    /// @notice Lets a grant that has not ended end later; nothing else of it changes, and the epoch goes on.
    /// @param grantee whose grant
    /// @param expiry its new end, seconds, later than the one it has; 0 means no end
    function extend(address grantee, uint64 expiry) external acting {
        Grant storage grant = grantOf[msg.sender][grantee];
        require(standing(grant), "no grant");
        require(grant.expiry != 0 && (expiry == 0 || expiry > grant.expiry), "shorter");
        grant.expiry = expiry;
        emit Extended(msg.sender, grantee, expiry);
    }

    /// @notice Gives grantees the envelopes of a further epoch.
    /// @param grantees accounts whose grants have not ended
    /// @param epoch the epoch whose key the envelopes carry; at most the current one
    /// @param envelopes one for each grantee
    function wrap(address[] calldata grantees, uint64 epoch, bytes[] calldata envelopes) external acting {
        require(grantees.length <= MOST_WRAPS && grantees.length == envelopes.length, "length");
        for (uint256 index = 0; index < grantees.length; index++) {
            address grantee = grantees[index];
            require(standing(grantOf[msg.sender][grantee]), "no grant");
            setWrapped(grantee, epoch, envelopes[index]);
            emit Wrapped(msg.sender, grantee, epoch, envelopes[index]);
        }
    }

    /// @notice Ends a grant, and with it the sender's epoch.
    /// @param grantee who may no longer read what is sealed from now on
    /// @param newToken the token of the next epoch
    /// @param envelope the next epoch's key, wrapped for the sender itself
    function authorityRevoke(address grantee, bytes32 newToken, bytes calldata envelope) external registered {
        Grant storage grant = grantOf[msg.sender][grantee];
        require(grant.active, "no grant");
        grant.active = false;
        grant.revokes += 1;
        Account storage account = accounts[msg.sender];
        setToken(account, newToken);
        emit Revoked(msg.sender, grantee, account.epoch, newToken);
        keepEnvelope(account.epoch, envelope);
    }

    // ---- devices ----

    /// @notice Lets a device sign records for the sender.
    /// @param device SM3 of the device's SM2 public key
    /// @param until when the loan ends, seconds; 0 means no end
    function lend(bytes32 device, uint64 until) external acting {
        require(device != 0, "empty");
        require(until == 0 || until > block.timestamp, "expired");
        loanOf[msg.sender][device] = Loan(true, until, uint64(block.number), 0);
        emit Lent(msg.sender, device, until);
    }

    /// @notice Takes a loan back.
    /// @param device SM3 of the device's SM2 public key
    function recall(bytes32 device) external registered {
        Loan storage loan = loanOf[msg.sender][device];
        require(loan.active, "no loan");
        loan.active = false;
        loan.recalledAt = uint64(block.number);
        emit Recalled(msg.sender, device);
    }

    // ---- administrator ----

    /// @notice Lets an account register while registration is closed.
    /// @param account who
    function admit(address account) external onlyAdministrator {
        require(!admitted[account], "unchanged");
        admitted[account] = true;
        emit Admitted(account);
    }

    /// @notice Withdraws an admission. Whoever registered meanwhile stays registered.
    /// @param account who
    function dismiss(address account) external onlyAdministrator {
        require(admitted[account], "unchanged");
        admitted[account] = false;
        emit Dismissed(account);
    }

    /// @notice Opens registration to all, or closes it.
    /// @param open_ whether anyone may register
    function setOpen(bool open_) external onlyAdministrator {
        require(open != open_, "unchanged");
        open = open_;
        emit OpenChanged(open_);
    }

    /// @notice Stops an account's changes, but not those that take rights away.
    /// @param account who
    function suspend(address account) external onlyAdministrator {
        require(!accounts[account].suspended, "unchanged");
        accounts[account].suspended = true;
        emit Suspended(account);
    }

    /// @notice Frees a suspended account. One that has a successor stays suspended.
    /// @param account who
    function restore(address account) external onlyAdministrator {
        require(accounts[account].suspended, "unchanged");
        require(successorOf[account] == address(0), "succeeded");
        accounts[account].suspended = false;
        emit Restored(account);
    }

    /// @notice Stops all changes but those that take rights away, until a time. They go on by themselves then.
    /// @param until when they go on, seconds; at most three days ahead, and not within a week of the last pause
    function pause(uint64 until) external onlyAdministrator {
        require(until > block.timestamp && until <= block.timestamp + LONGEST_PAUSE, "pause");
        require(pausedUntil == 0 || block.timestamp >= uint256(pausedUntil) + SHORTEST_GAP, "gap");
        pausedUntil = until;
        emit PausedUntil(until);
    }

    /// @notice Lets changes go on before the pause's end.
    function resume() external onlyAdministrator {
        require(paused(), "unchanged");
        pausedUntil = uint64(block.timestamp);
        emit PausedUntil(uint64(block.timestamp));
    }

    /// @notice Proposes who continues the work of a lost account. It waits for the delay; where the owner had named no
    ///         recovery account that is in effect now, for twice the delay.
    /// @param lost the account whose key is lost or stolen
    /// @param successor a registered account that is not suspended
    function proposeSuccession(address lost, address successor) external onlyAdministrator {
        require(accounts[lost].epoch != 0 && accounts[successor].epoch != 0, "unregistered");
        require(lost != successor, "self");
        require(!accounts[successor].suspended, "successor");
        require(successorOf[lost] == address(0), "succeeded");
        require(proposalOf[lost].due == 0, "pending");
        address recovery = recoveryInEffect(recoveries[lost]);
        uint64 due = uint64(block.timestamp) + (recovery == address(0) ? 2 * delay : delay);
        proposalOf[lost] = Proposal(successor, due, recovery);
        emit SuccessionProposed(lost, successor, recovery, due);
    }

    /// @notice Stops a succession that waits: only for the recovery account that was in effect when it was proposed, and
    ///         for the administrator. The lost account itself cannot, for its thief must not.
    /// @param lost whose succession
    function cancelSuccession(address lost) external {
        Proposal storage proposal = proposalOf[lost];
        require(proposal.due != 0, "no proposal");
        require(msg.sender == proposal.recovery || msg.sender == administrator, "recovery");
        delete proposalOf[lost];
        emit SuccessionCancelled(lost, msg.sender);
    }

    /// @notice Completes a succession whose time has come; anybody may. The lost account is suspended for good.
    /// @dev A lost account stays suspended, so successors never form a circle and whoever follows them ends.
    /// @param lost whose succession
    function completeSuccession(address lost) external {
        Proposal storage proposal = proposalOf[lost];
        address successor = proposal.successor;
        require(proposal.due != 0, "no proposal");
        require(block.timestamp >= proposal.due, "early");
        require(!accounts[successor].suspended, "successor");
        delete proposalOf[lost];
        successorOf[lost] = successor;
        accounts[lost].suspended = true;
        emit Succeeded(lost, successor);
    }

    /// @notice Names the next administrator, who takes over by accepting.
    /// @param nominee_ who; the zero address withdraws
    function nominate(address nominee_) external onlyAdministrator {
        nominee = nominee_;
        emit AdministratorNominated(nominee_);
    }

    /// @notice Takes over as administrator; only for the nominee.
    function acceptAdministrator() external {
        require(msg.sender == nominee, "nominee");
        emit AdministratorChanged(administrator, msg.sender);
        administrator = msg.sender;
        nominee = address(0);
    }

    // ---- reads ----

    /// @notice The state of an account.
    /// @param owner who
    /// @return identity token at registration or key rotation || P_C || P_E || proof; empty where not registered
    /// @return epoch current; 0 where not registered
    /// @return token of the current epoch
    /// @return suspended whether its changes are stopped
    /// @return keys version of the SM2 keys, from 1
    /// @return count of digests uploaded
    /// @return last digest uploaded
    function accountOf(address owner)
        external
        view
        returns (
            bytes memory identity,
            uint64 epoch,
            bytes32 token,
            bool suspended,
            uint64 keys,
            uint64 count,
            bytes32 last
        )
    {
        Account storage account = accounts[owner];
        identity = account.identity;
        epoch = account.epoch;
        token = account.token;
        suspended = account.suspended;
        keys = account.keys;
        count = account.count;
        last = account.last;
    }

    /// @notice The root that an account anchored last.
    /// @param account who
    /// @return root the last one; zero where there is none
    function headOf(address account) public view returns (bytes32 root) {
        root = heads[account];
        if (root == NO_ROOT) root = 0;
    }

    /// @notice Whether changes are stopped now.
    /// @return stopped whether they are
    function paused() public view returns (bool stopped) {
        stopped = block.timestamp < pausedUntil;
    }

    /// @notice Who may stop a succession of an account that is proposed now, and who was named to from a time on.
    /// @param owner whose
    /// @return recovery who may; zero where nobody
    /// @return next who was named last; zero where nobody
    /// @return from when `next` takes effect, or took; 0 where the owner never named anybody
    function recoveryOf(address owner) external view returns (address recovery, address next, uint64 from) {
        Recovery storage named = recoveries[owner];
        recovery = recoveryInEffect(named);
        next = named.next;
        from = named.from;
    }

    // ---- inner ----

    /// @dev Notes an account's keys under their version, for good.
    function setKeys(Account storage account, uint64 keys, bytes calldata identity) private {
        account.keys = keys;
        account.identity = identity;
        keysOf[msg.sender][keys] = Keys(keccak256(identity), uint64(block.number), uint64(block.timestamp));
    }

    /// @dev The recovery account that is in effect now.
    function recoveryInEffect(Recovery storage named) private view returns (address) {
        return named.from != 0 && block.timestamp >= named.from ? named.next : named.current;
    }

    /// @dev Begins the sender's next epoch with a token that it never used.
    function setToken(Account storage account, bytes32 token) private {
        require(token != 0, "empty");
        require(epochOf[msg.sender][token] == 0, "token used");
        account.epoch += 1;
        account.token = token;
        epochOf[msg.sender][token] = account.epoch;
    }

    /// @dev Puts the envelope of the sender's new epoch among the events, for the sender itself: whoever has its keys and
    ///      the chain has every epoch. Nothing is stored, and what the envelope carries cannot be checked here.
    function keepEnvelope(uint64 epoch, bytes calldata envelope) private {
        require(envelope.length <= LONGEST_ENVELOPE, "envelope");
        if (envelope.length != 0) emit Wrapped(msg.sender, msg.sender, epoch, envelope);
    }

    /// @dev Notes the one envelope of (sender, grantee, epoch): one more only after a revoke or for new keys.
    function setWrapped(address grantee, uint64 epoch, bytes calldata envelope) private {
        uint64 keys = accounts[grantee].keys;
        require(keys != 0, "grantee");
        require(epoch != 0 && epoch <= accounts[msg.sender].epoch, "epoch");
        require(envelope.length != 0 && envelope.length <= LONGEST_ENVELOPE, "envelope");
        Envelope storage given = envelopeOf[msg.sender][grantee][epoch];
        uint64 revokes = grantOf[msg.sender][grantee].revokes;
        require(given.keys < keys || given.revokes < revokes, "wrapped");
        given.keys = keys;
        given.revokes = revokes;
    }

    /// @dev Whether `reader` may read `owner`'s records of `epoch` now.
    function mayRead(address owner, address reader, uint64 epoch) private view returns (bool) {
        if (reader == owner) return true;
        Grant storage grant = grantOf[owner][reader];
        if (!standing(grant) || accounts[reader].suspended) return false;
        Envelope storage given = envelopeOf[owner][reader][epoch];
        return epoch >= grant.epoch || (given.keys != 0 && given.revokes == grant.revokes);
    }

    /// @dev Whether a grant is neither revoked nor expired.
    function standing(Grant storage grant) private view returns (bool) {
        return grant.active && (grant.expiry == 0 || block.timestamp < grant.expiry);
    }

    /// @dev Zero for all topics, else the hash of their ids, each filled up with zeros to 32 bytes.
    function scopeHash(bytes16[] calldata scope) private pure returns (bytes32) {
        return scope.length == 0 ? bytes32(0) : keccak256(abi.encodePacked(scope));
    }

    /// @dev The token at the front of an identity.
    function tokenOf(bytes calldata identity) private pure returns (bytes32) {
        require(identity.length == IDENTITY_LENGTH, "length");
        return abi.decode(identity[:32], (bytes32));
    }

    /// @dev Exactly 32 bytes as a word.
    function word(bytes calldata text) private pure returns (bytes32) {
        require(text.length == 32, "length");
        return abi.decode(text, (bytes32));
    }
}
