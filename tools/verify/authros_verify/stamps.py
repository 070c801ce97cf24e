"""Time stamps (RFC 3161 in CMS SignedData of RFC 5652), and the way from their signer to a pinned certificate. Revocation is not looked up."""
from .certificates import Certificate, Unknown, digest_of, hash_name, oid, scheme
from .der import BOOLEAN, GENERALIZED_TIME, INTEGER, OBJECT, OCTETS, SEQUENCE, SET, Der, context, primitive, seconds, small

SIGNED_DATA, STAMP = oid("1.2.840.113549.1.7.2"), oid("1.2.840.113549.1.9.16.1.4")
CONTENT_TYPE, MESSAGE_DIGEST = oid("1.2.840.113549.1.9.3"), oid("1.2.840.113549.1.9.4")
# RFC 2634, by SHA-1, and RFC 5035.
SIGNING_CERTIFICATE, SIGNING_CERTIFICATE_2 = oid("1.2.840.113549.1.9.16.2.12"), oid("1.2.840.113549.1.9.16.2.47")
MOST_CERTIFICATES, MOST_ATTRIBUTES, LONGEST_WAY = 8, 16, 6


class NotPinned(Exception):
    """No certificate links it to this pin."""


class Token:
    """Whatever is wrong with its form is a ValueError."""

    def __init__(self, data):
        outer = Der.only(data, SEQUENCE)
        if outer.object() != SIGNED_DATA:
            raise ValueError("it is not signed data")
        wrapped = outer.inside(context(0))
        outer.end()
        inner = wrapped.inside(SEQUENCE)
        wrapped.end()
        if inner.small() != 3:
            raise ValueError("its version is not 3")
        hashes = inner.inside(SET)
        name = hash_name(hashes)
        hashes.end()
        self.read_content(inner.inside(SEQUENCE))
        self.certificates = []
        listed = inner.inside_optional(context(0))
        while listed is not None and listed.rest:
            if len(self.certificates) == MOST_CERTIFICATES:
                raise ValueError("it includes more than 8 certificates")
            self.certificates.append(Certificate(listed.element(SEQUENCE).whole))
        signers = inner.inside(SET)
        self.read_signer(signers.inside(SEQUENCE))
        signers.end()
        inner.end()
        if self.hash != name:
            raise ValueError("it names a different hash than its signer does")
        self.read_info(Der.only(self.content, SEQUENCE))

    def read_content(self, about):
        if about.object() != STAMP:
            raise ValueError("it is signed data, but not a time stamp")
        explicit = about.inside(context(0))
        self.content = explicit.element(OCTETS).content
        explicit.end()
        about.end()

    def read_signer(self, one):
        if one.small() != 1:
            raise ValueError("it does not name its certificate by issuer and serial number")
        sid = one.inside(SEQUENCE)
        self.issuer, self.serial = sid.element(SEQUENCE).whole, sid.integer()
        sid.end()
        self.hash = hash_name(one)
        listed = one.element(context(0))
        # What is signed is the attributes as a SET.
        self.signed = bytes([SET]) + listed.whole[1:]
        kind, name = scheme(one)
        if name not in (None, self.hash):
            raise ValueError("it names two hashes")
        self.scheme = kind, self.hash
        self.signature = one.element(OCTETS).content
        one.end()
        self.attributes = {}
        everything = Der(listed.content)
        while everything.rest:
            attribute = everything.inside(SEQUENCE)
            name, values = attribute.object(), attribute.inside(SET)
            value = values.any().whole
            values.end()
            attribute.end()
            if name in self.attributes or len(self.attributes) == MOST_ATTRIBUTES:
                raise ValueError("an attribute is a duplicate, or one too many")
            self.attributes[name] = value

    def read_info(self, info):
        if info.small() != 1:
            raise ValueError("its version is not 1")
        info.element(OBJECT)
        over = info.inside(SEQUENCE)
        if hash_name(over) != "sha256":
            raise ValueError("its message imprint is not SHA-256")
        self.imprint = over.element(OCTETS).content
        over.end()
        info.integer()
        time = info.element(GENERALIZED_TIME)
        accuracy = info.inside_optional(SEQUENCE)
        late = 0 if accuracy is None else spread(accuracy)
        if info.next_tag() == BOOLEAN:
            info.boolean()
        if info.next_tag() == INTEGER:
            info.integer()
        info.optional(context(0))
        info.end()
        self.at, self.before = seconds(time), seconds(time, True) + late

    def attribute(self, name):
        if name not in self.attributes:
            raise ValueError("a required attribute is missing")
        return Der(self.attributes[name])


def spread(accuracy):
    """In whole seconds, rounded up."""
    whole, part = accuracy.small() if accuracy.next_tag() == INTEGER else 0, 0
    for number in (0, 1):
        fraction = accuracy.optional(primitive(number))
        if fraction is not None:
            if not fraction.content or not 1 <= small(fraction.content) <= 999:
                raise ValueError("its accuracy is invalid")
            part = 1
    accuracy.end()
    return whole + part


def check_content(token):
    kind, digest = token.attribute(CONTENT_TYPE), token.attribute(MESSAGE_DIGEST)
    is_stamp = kind.object() == STAMP
    is_this = digest.element(OCTETS).content == digest_of(token.hash, token.content)
    kind.end()
    digest.end()
    if not (is_stamp and is_this):
        raise ValueError("its signature covers different content")


def check_named(token, certificate):
    """ESSCertID or ESSCertIDv2: no other certificate with the same key can take its place."""
    found = False
    for name, is_second in ((SIGNING_CERTIFICATE_2, True), (SIGNING_CERTIFICATE, False)):
        if name not in token.attributes:
            continue
        value = Der(token.attributes[name])
        outer = value.inside(SEQUENCE)
        value.end()
        own = outer.inside(SEQUENCE).inside(SEQUENCE)
        algorithm = "sha1"
        if is_second:
            algorithm = hash_name(own) if own.next_tag() == SEQUENCE else "sha256"
        if own.element(OCTETS).content != digest_of(algorithm, certificate.der):
            raise ValueError("its signature does not name its certificate")
        found = True
    if not found:
        raise ValueError("its signature does not name its certificate")


def issued(above, below, between):
    if not above.may_issue() or above.most_below < between:
        raise ValueError("a certificate on the way may not issue others")
    if not below.is_signed_by(above):
        raise ValueError("a certificate on the way is not signed by the one above it")


def check_way(first, others, pinned, at):
    last, fault = first, None
    for below in range(LONGEST_WAY):
        if not last.is_valid_at(at):
            raise ValueError("a certificate on the way was not valid then")
        if last.is_unknown:
            raise ValueError("a certificate on the way has an unknown critical extension")
        if last.der == pinned.der:
            return
        for above in (pinned, *others):
            if above.subject != last.issuer or above.der == last.der:
                continue
            try:
                issued(above, last, below)
                break
            except ValueError as why:
                fault = fault or why
        else:
            raise fault or NotPinned
        last = above
    raise NotPinned


def check_token(data, imprint, pinned):
    """Before which second the stamped data existed, by whom, and the place of the pin it leads to or None; else ValueError."""
    token = Token(data)
    if token.imprint != imprint:
        raise ValueError("it stamps something else")
    is_signers = lambda one: (one.issuer, one.serial) == (token.issuer, token.serial)
    certificate = next(filter(is_signers, [*token.certificates, *pinned]), None)
    if certificate is None:
        raise ValueError("it does not include its signer's certificate")
    check_content(token)
    check_named(token, certificate)
    if not certificate.key.verifies(token.scheme, token.signed, token.signature):
        raise ValueError("its signature is invalid")
    if not certificate.may_stamp():
        raise ValueError("its certificate is not restricted to time stamping")
    if not certificate.is_valid_at(token.at):
        raise ValueError("its certificate was not valid then")
    fault = None
    for place, pin in enumerate(pinned):
        try:
            check_way(certificate, token.certificates, pin, token.at)
            return token.before, certificate.name(), place
        except NotPinned:
            continue
        except ValueError as why:
            fault = fault or why
    if fault:
        raise fault
    return token.before, certificate.name(), None
