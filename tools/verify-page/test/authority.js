// A time stamp authority made with openssl alone: keys, certificates and tokens.

import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const SETTINGS = `[req]
distinguished_name = dn
prompt = no
[dn]
CN = unused
[ca]
basicConstraints = critical,CA:true
keyUsage = critical,keyCertSign,cRLSign
[stamps]
basicConstraints = CA:false
keyUsage = critical,digitalSignature
extendedKeyUsage = critical,timeStamping
[plain]
keyUsage = critical,digitalSignature
[loose]
extendedKeyUsage = timeStamping
[both]
extendedKeyUsage = critical,timeStamping,codeSigning
[odd]
extendedKeyUsage = critical,timeStamping
1.2.3.4 = critical,DER:0500
${["sha256", "sha384", "sha512"].map(section).join("")}`;

function section(hash) {
  return `[${hash}]
serial = ./serial
default_policy = 1.2.3.4.1
digests = sha256,sha512
signer_digest = ${hash}
accuracy = secs:1, millisecs:500
ess_cert_id_alg = ${hash === "sha512" ? "sha1" : hash}
`;
}

export const RSA = "-algorithm RSA -pkeyopt rsa_keygen_bits:2048";
export const RSA_PSS = "-algorithm RSA-PSS -pkeyopt rsa_keygen_bits:2048";
export const P256 = "-algorithm EC -pkeyopt ec_paramgen_curve:P-256";
export const P384 = "-algorithm EC -pkeyopt ec_paramgen_curve:P-384";

export class Authority {
  folder = mkdtempSync(join(tmpdir(), "authority-"));

  constructor() {
    this.write("settings", SETTINGS);
    this.write("serial", "01\n");
    this.root("root", P384, "the root");
  }

  write(name, bytes) {
    writeFileSync(join(this.folder, name), bytes);
  }

  read(name) {
    return new Uint8Array(readFileSync(join(this.folder, name)));
  }

  pem(name) {
    return readFileSync(join(this.folder, `${name}.pem`), "utf8");
  }

  openssl(line, ...more) {
    const env = { ...process.env, OPENSSL_CONF: join(this.folder, "settings") };
    return execFileSync("openssl", [...line.split(" ").filter(Boolean), ...more], {
      cwd: this.folder,
      env,
      stdio: "pipe",
    });
  }

  root(name, key, subject) {
    this.openssl(`genpkey ${key} -out ${name}.key`);
    this.openssl(
      `req -x509 -new -key ${name}.key -days 30 -config settings -extensions ca -out ${name}.pem`,
      "-subj",
      `/CN=${subject}`,
    );
  }

  issue(name, key, by, extensions, more = "") {
    this.openssl(`genpkey ${key} -out ${name}.key`);
    this.openssl(`req -new -key ${name}.key -config settings -out ${name}.csr -subj /CN=${name}`);
    const serial = [...name].reduce((sum, letter) => (sum * 31 + letter.charCodeAt(0)) % 1_000_003, 17);
    this.openssl(
      `x509 -req -in ${name}.csr -CA ${by}.pem -CAkey ${by}.key -set_serial ${serial} -days 20 -extfile settings -extensions ${extensions} ${more} -out ${name}.pem`,
    );
  }

  /** A token over an imprint, which is in hex. */
  token(imprint, signer, section = "sha256", more = "", hash = "sha256") {
    this.openssl(`ts -query -digest ${imprint} -${hash} -cert -out request`);
    this.openssl(
      `ts -reply -queryfile request -config settings -section ${section} -signer ${signer}.pem -inkey ${signer}.key ${more} -token_out -out token`,
    );
    return this.read("token");
  }

  /** What a token's signature is over. */
  content(token) {
    this.write("token", token);
    this.openssl("cms -verify -noverify -binary -inform DER -in token -out content");
    return this.read("content");
  }

  /** A token with this content, signed by hand. */
  signed(content, signer, more = "-md sha256 -cades") {
    this.write("content", content);
    this.openssl(
      `cms -sign -binary -nodetach -econtent_type 1.2.840.113549.1.9.16.1.4 -nosmimecap -outform DER -signer ${signer}.pem -inkey ${signer}.key ${more} -in content -out signed`,
    );
    return this.read("signed");
  }
}
