// Another implementation (@ethereumjs, with @noble's curves): tries and their proofs, a Clique chain, headers of QBFT.
// tests/support/foreign.rs runs it in the folder with node_modules, with a file of JSON {what, ...}; the answer is JSON.
import { readFileSync } from 'node:fs'
import { createBlock, createBlockHeaderFromRLP, createSealedCliqueBlock, cliqueSigner } from '@ethereumjs/block'
import { createBlockchain, CliqueConsensus } from '@ethereumjs/blockchain'
import { createCommonFromGethGenesis } from '@ethereumjs/common'
import { MerklePatriciaTrie, createMerkleProof, verifyMPTWithMerkleProof } from '@ethereumjs/mpt'
import { RLP } from '@ethereumjs/rlp'
import { bytesToHex, concatBytes, createAddressFromPrivateKey, hexToBytes } from '@ethereumjs/util'
import { secp256k1 } from '@noble/curves/secp256k1.js'
import { keccak_256 } from '@noble/hashes/sha3.js'

const hex = (bytes) => bytesToHex(bytes)
const bytes = (text) => hexToBytes(text)
const number = (value) => {
  const digits = BigInt(value).toString(16)
  return value === 0n || value === 0 ? new Uint8Array() : bytes('0x' + (digits.length % 2 ? '0' : '') + digits)
}
const sign = (hash, key) => {
  const signature = secp256k1.sign(hash, key, { prehash: false, format: 'recovered' })
  return concatBytes(signature.subarray(1), signature.subarray(0, 1))
}

// Random draws from a seed, so that a failure can be seen again.
const draws = (seed) => {
  let state = BigInt(seed)
  const next = () => {
    state = (state * 6364136223846793005n + 1442695040888963407n) & 0xffffffffffffffffn
    return Number(state >> 33n)
  }
  return { below: (limit) => next() % limit, bytes: (length) => Uint8Array.from({ length }, () => next() & 255) }
}

const trie = () => new MerklePatriciaTrie({ useKeyHashing: true })

const verified = async (root, key, proof) => {
  const value = await verifyMPTWithMerkleProof(trie(), bytes(root), bytes(key), proof.map(bytes))
  return value === null || value === undefined ? null : hex(value)
}

const answers = {
  // Random tries, and the proofs of keys that are in them and of keys that are not.
  async tries({ seed, cases }) {
    const random = draws(seed)
    const found = []
    while (found.length < cases) {
      const [one, keys] = [trie(), []]
      for (let left = random.below(120); left >= 0; left -= 1) {
        const key = random.bytes(1 + random.below(40))
        await one.put(key, RLP.encode(random.bytes(1 + random.below(40))))
        keys.push(key)
      }
      for (let left = 0; left < 20 && found.length < cases; left += 1) {
        const key = left % 2 ? keys[random.below(keys.length)] : random.bytes(1 + random.below(40))
        const value = await one.get(key)
        const proof = await createMerkleProof(one, key)
        found.push({ root: hex(one.root()), key: hex(key), value: value ? hex(value) : null, proof: proof.map(hex) })
      }
    }
    return found
  },

  // What proofs show: a value, null where they show that there is none, or why they are no proof.
  async verify({ proofs }) {
    const found = []
    for (const { root, key, proof } of proofs) {
      try {
        found.push({ value: await verified(root, key, proof) })
      } catch (error) {
        found.push({ error: String(error.message) })
      }
    }
    return found
  },

  // Words of a contract's storage after a block, from its header and nodes of the state as they are in a bundle.
  async words({ header, nodes, contract, slots, genesis }) {
    const common = createCommonFromGethGenesis(genesis, { chain: 'ours' })
    const head = createBlockHeaderFromRLP(bytes(header), { common, skipConsensusFormatValidation: true })
    const state = new MerklePatriciaTrie({ useKeyHashing: true, root: head.stateRoot })
    const below = RLP.decode(bytes(nodes)).map((node) => ({ type: 'put', key: keccak_256(node), value: node }))
    await state.database().batch(below)
    const account = RLP.decode(await state.get(bytes(contract), true))
    const storage = new MerklePatriciaTrie({ useKeyHashing: true, root: account[2] })
    await storage.database().batch(below)
    const words = []
    for (const slot of slots) {
      const value = await storage.get(bytes(slot), true)
      words.push(value ? hex(RLP.decode(value)) : null)
    }
    return { hash: hex(head.hash()), sealer: cliqueSigner(head).toString(), code_hash: hex(account[3]), words }
  },

  // A Clique chain by these keys, one block each in its turn, which the library itself takes block by block. The state
  // after block `at` has the contract with these words; the answer has headers, and the nodes that prove the words.
  async clique({ genesis, keys, length, at, contract, code_hash, words }) {
    const common = createCommonFromGethGenesis(genesis, { chain: 'foreign' })
    const consensusDict = { clique: new CliqueConsensus() }
    const first = createBlock({ header: { ...genesisHeader(genesis) } }, { common, skipConsensusFormatValidation: true })
    const chain = await createBlockchain({ common, genesisBlock: first, validateBlocks: true, validateConsensus: true, consensusDict })
    const storage = trie()
    for (const [slot, word] of words) await storage.put(bytes(slot), RLP.encode(bytes(word)))
    const state = trie()
    const random = draws(length)
    for (let left = 0; left < 50; left += 1) await state.put(random.bytes(20), RLP.encode(random.bytes(70)))
    await state.put(bytes(contract), RLP.encode([number(1), number(0), storage.root(), bytes(code_hash)]))
    const signers = keys.map((key) => ({ key: bytes(key), account: createAddressFromPrivateKey(bytes(key)) }))
    signers.sort((one, other) => (one.account.toString() < other.account.toString() ? -1 : 1))
    const headers = [first.header]
    for (let height = 1; height <= length; height += 1) {
      const signer = signers[height % signers.length]
      const [parent, isProven] = [headers[height - 1], height === at]
      const header = {
        parentHash: parent.hash(), number: height, timestamp: parent.timestamp + 1n, gasLimit: parent.gasLimit, difficulty: 2n,
        stateRoot: isProven ? state.root() : random.bytes(32), extraData: new Uint8Array(97),
      }
      const block = createSealedCliqueBlock({ header }, signer.key, { common, skipConsensusFormatValidation: false })
      await chain.putBlock(block)
      headers.push(block.header)
    }
    const nodes = await createMerkleProof(state, bytes(contract))
    for (const [slot] of words) nodes.push(...(await createMerkleProof(storage, bytes(slot))))
    return {
      genesis: hex(first.header.hash()), signers: signers.map(({ account }) => account.toString()), nodes: nodes.map(hex),
      headers: headers.slice(1).map((header) => ({
        number: Number(header.number), rlp: hex(RLP.encode(header.raw())), hash: hex(header.hash()), sealer: cliqueSigner(header).toString(),
      })),
    }
  },

  // Headers sealed as Besu's documentation says, under QBFT and IBFT 2.0.
  async committed({ seed, cases }) {
    const random = draws(seed)
    return Array.from({ length: cases }, () => {
      const isIbft = random.below(2) === 1
      const keys = Array.from({ length: 1 + random.below(10) }, () => random.bytes(32))
      const accounts = keys.map((key) => createAddressFromPrivateKey(key).toBytes())
      const round = random.below(3) ? random.below(3) : random.below(100000)
      const vote = random.below(3) ? null : [random.bytes(20), random.below(2) ? bytes('0xff') : new Uint8Array()]
      const isKept = random.below(4) === 0
      const begun = [random.bytes(32), isKept ? [] : accounts, vote ?? (isIbft ? new Uint8Array() : [])]
      const written = (value) => (isIbft ? bytes('0x' + value.toString(16).padStart(8, '0')) : number(value))
      const fields = [
        random.bytes(32), random.bytes(32), random.bytes(20), random.bytes(32), random.bytes(32), random.bytes(32),
        random.bytes(256), number(1), number(1 + random.below(1000000)), number(random.below(2 ** 30)), number(random.below(2 ** 30)),
        number(1700000000 + random.below(1000000)), null, new TextEncoder().encode('ctical byzantine fault tolerance'), new Uint8Array(8),
      ]
      // Later forks add fields.
      for (let more = random.below(4); more > 0; more -= 1) fields.push(random.bytes(32))
      const header = (extra) => RLP.encode(fields.map((field, at) => (at === 12 ? RLP.encode(extra) : field)))
      const signed = keccak_256(header(isIbft ? [...begun, written(round)] : [...begun, written(round), []]))
      const sealers = keys.map((key, at) => [key, accounts[at]]).filter(() => random.below(5) > 0)
      const seals = sealers.map(([key]) => sign(signed, key))
      return {
        rlp: hex(header([...begun, written(round), seals])), hash: hex(keccak_256(header(isIbft ? begun : [...begun, number(0), []]))),
        is_ibft: isIbft, is_kept: isKept, round, accounts: accounts.map(hex), sealers: sealers.map(([, account]) => hex(account)),
      }
    })
  },
}

function genesisHeader(genesis) {
  const { extraData, gasLimit, difficulty, timestamp, mixHash, nonce } = genesis
  return { number: 0, extraData, gasLimit, difficulty, timestamp, mixHash, nonce: '0x' + BigInt(nonce).toString(16).padStart(16, '0') }
}

const request = JSON.parse(readFileSync(process.argv.at(-1), 'utf8'))
process.stdout.write(JSON.stringify(await answers[request.what](request)))
