"""Certificates: the authority, their content, and how they are read. Keys are EC P-256."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from formation.deploy.refusal import Refusal, refuse_os_errors

EARLY = timedelta(hours=1)
"""Time before their making from which certificates are valid, as a robot's clock may be behind."""


class Pair(NamedTuple):
    """A certificate and the key that belongs to it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @property
    def name(self) -> str:
        """The owner: its common name."""
        return common_name(self.certificate)

    @property
    def expires(self) -> datetime:
        """When it expires."""
        return self.certificate.not_valid_after_utc

    @property
    def certificate_pem(self) -> bytes:
        """The certificate as file content."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """The key as file content: secret, without a password."""
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


def new_authority(name: str, days: float, now: datetime) -> Pair:
    """Return a new certificate authority, with its own certificate as the root of trust."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = (
        _builder(name, name, key.public_key(), now, timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return Pair(builder.sign(key, hashes.SHA256()), key)


def issue(authority: Pair, name: str, address: str | None, days: float, now: datetime) -> Pair:
    """Return a certificate for `name`, which listens at `address` (None: nowhere).

    A process that listens nowhere gets one only for dialling. None outlives its authority.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    lifetime = min(timedelta(days=days), authority.expires - now)
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = (
        _builder(name, authority.name, key.public_key(), now, lifetime)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), critical=False
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    if address is not None:
        purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
        builder = builder.add_extension(
            x509.SubjectAlternativeName([_alternative_name(address)]), critical=False
        )
    builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
    return Pair(builder.sign(authority.key, hashes.SHA256()), key)


def read(certificate: Path, key: Path) -> Pair:
    """Return a certificate and its key from their files. Raises Refusal if they cannot be used."""
    cert = read_certificate(certificate)
    try:
        secret = serialization.load_pem_private_key(_bytes(key), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise Refusal(f"{key}: is not a key that can be read without a password") from None
    if not isinstance(secret, ec.EllipticCurvePrivateKey) or secret.public_key() != cert.public_key():
        raise Refusal(f"{key}: is not the key of {certificate}; issue both again with --renew")
    return Pair(cert, secret)


def read_certificate(path: Path) -> x509.Certificate:
    """Return a certificate from its file. Raises Refusal."""
    try:
        return x509.load_pem_x509_certificate(_bytes(path))
    except ValueError:
        raise Refusal(f"{path}: is not a certificate") from None


def common_name(certificate: x509.Certificate) -> str:
    """Return the owner's common name."""
    return "".join(
        str(attribute.value) for attribute in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    )


def addresses(certificate: x509.Certificate) -> Sequence[str]:
    """Return where its owner may listen: IP addresses and DNS names."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return (
        *map(str, names.get_values_for_type(x509.IPAddress)),
        *names.get_values_for_type(x509.DNSName),
    )


def _builder(
    name: str, issuer: str, public: ec.EllipticCurvePublicKey, now: datetime, lifetime: timedelta
) -> x509.CertificateBuilder:
    now = now.astimezone(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(_distinguished(name))
        .issuer_name(_distinguished(issuer))
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLY)
        .not_valid_after(now + lifetime)
    )


def _distinguished(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _alternative_name(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _bytes(path: Path) -> bytes:
    with refuse_os_errors(f"{path}"):
        return path.read_bytes()
