"""Signatures on orders, by the keys of the processes' links: EC P-256, ECDSA with SHA-256.

Only this module needs `cryptography`; it is imported only if certificates are configured. A signature is
64 bytes (r and s, big endian, s in the lower half), so it has exactly one encoding; the 9 bytes before it
identify the key that verifies it. Both are Base64 without padding.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, utils
from cryptography.x509.oid import NameOID

from formation.transport.bus_config import BusError
from formation.transport.session import Identity

KEY_ID_BYTES, NUMBER_BYTES = 9, 32
ORDER_OF_P256 = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
_ECDSA = ec.ECDSA(hashes.SHA256())


class BadSignature(ValueError):  # noqa: N818 - the signature, or the certificate, is what is bad
    """Not a signature or a certificate of the fleet; the text says why."""


class Certified(NamedTuple):
    """A certificate that the fleet's authority has issued."""

    name: str
    """Common name."""
    key_id: str
    """Id of its key, with which signatures begin."""
    begins: float
    ends: float
    """Valid from and until [s since the epoch]."""
    verifies: Callable[[str, bytes], bool]
    """Whether ``verifies(signature, message)``."""


class Authority:
    """The fleet's certificate authority, which binds keys to names."""

    def __init__(self, file: Path) -> None:
        """`file`: its certificate, or several (PEM). Raises BusError."""
        try:
            self._certificates = x509.load_pem_x509_certificates(_bytes(file))
        except ValueError:
            raise BusError(f"{file}: must be the authority's certificate (PEM)") from None

    def read(self, text: str) -> Certified:
        """Read a certificate (DER in Base64). Raises BadSignature unless the authority issued it."""
        try:
            certificate = x509.load_der_x509_certificate(_decoded(text))
            key = certificate.public_key()
            usage = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
            names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        except (ValueError, UnsupportedAlgorithm, x509.ExtensionNotFound, x509.DuplicateExtension) as error:
            raise BadSignature(f"certificate cannot be read: {error}") from None
        if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
            raise BadSignature("certificate's key must be EC P-256")
        if usage.ca or len(names) != 1:
            raise BadSignature("certificate must be that of one process")
        if not any(issued_by(certificate, one) for one in self._certificates):
            raise BadSignature(f"certificate of {str(names[0].value)[:64]!r} is not of the fleet's authority")
        return Certified(
            str(names[0].value),
            _key_id(key),
            certificate.not_valid_before_utc.timestamp(),
            certificate.not_valid_after_utc.timestamp(),
            lambda signature, message: _verifies(key, signature, message),
        )


class Signer:
    """A candidate's key."""

    def __init__(self, identity: Identity, name: str, now: float) -> None:
        """`name` must be that of the certificate, `now` [s since the epoch]. Raises BusError."""
        if identity.key is None or identity.certificate is None:
            raise BusError(
                "transport/link/tls: enable_mtls needs connect_private_key and connect_certificate, with"
                " which orders are signed"
            )
        try:
            certificate = x509.load_pem_x509_certificate(_bytes(identity.certificate))
        except ValueError:
            raise BusError(f"{identity.certificate}: must be a certificate (PEM)") from None
        self.certificate = encoded(certificate.public_bytes(serialization.Encoding.DER))
        """As transmitted: DER in Base64."""
        try:
            certified = Authority(identity.authority).read(self.certificate)
        except BadSignature as bad:
            raise BusError(f"{identity.certificate}: {bad}") from None
        if certified.name != name:
            raise BusError(f"{identity.certificate}: is the certificate of {certified.name}, not of {name}")
        if not certified.begins <= now <= certified.ends:
            until = datetime.fromtimestamp(certified.ends, UTC)
            raise BusError(f"{identity.certificate}: is not valid now, but until {until:%Y-%m-%d %H:%M} UTC")
        self._key = _private_key(identity.key)
        self._id = _key_id(self._key.public_key())
        if self._id != certified.key_id:
            raise BusError(f"{identity.key}: is not the key of {identity.certificate}")

    def sign(self, message: bytes) -> str:
        """Sign `message`."""
        r, s = utils.decode_dss_signature(self._key.sign(message, _ECDSA))
        return self._id + encoded(_number(r) + _number(min(s, ORDER_OF_P256 - s)))


def _verifies(key: ec.EllipticCurvePublicKey, signature: str, message: bytes) -> bool:
    try:
        numbers = _decoded(signature[_ID_LENGTH:])
    except BadSignature:
        return False
    r, s = int.from_bytes(numbers[:NUMBER_BYTES]), int.from_bytes(numbers[NUMBER_BYTES:])
    if len(numbers) != 2 * NUMBER_BYTES or not 0 < s <= ORDER_OF_P256 // 2:
        return False
    try:
        key.verify(utils.encode_dss_signature(r, s), message, _ECDSA)
    except InvalidSignature:
        return False
    return True


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Return whether `authority` has signed it."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _private_key(file: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(_bytes(file), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise BusError(f"{file}: must be a private key (PEM) without a password") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise BusError(f"{file}: must be an EC P-256 key")
    return key


def _key_id(key: ec.EllipticCurvePublicKey) -> str:
    spelled = key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    return encoded(hashlib.sha256(spelled).digest()[:KEY_ID_BYTES])


_ID_LENGTH = 4 * KEY_ID_BYTES // 3


def key_id_of(signature: str) -> str:
    """The part of a signature that identifies the key to verify it."""
    return signature[:_ID_LENGTH]


def _number(value: int) -> bytes:
    return value.to_bytes(NUMBER_BYTES)


def encoded(data: bytes) -> str:
    """Return Base64 for a URL, without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def _decoded(text: str) -> bytes:
    """Decode Base64. Raises BadSignature for text that `encoded` does not make."""
    try:
        data = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):
        raise BadSignature("is not Base64") from None
    if encoded(data) != text:
        raise BadSignature("is not the only Base64 of its bytes")
    return data


def _bytes(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise BusError(f"{file}: {error.strerror}") from None
