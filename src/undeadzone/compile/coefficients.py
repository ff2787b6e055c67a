"""What the elementary functions of an arithmetic consist of.

The polynomials of float64 are of least largest error, by Remez's exchange in 60 digits, with the
weight that is named for each; those of float32 need a third of the terms.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Numbers(NamedTuple):
    """An arithmetic, and the numbers of its functions.

    Attributes:
        kind: of a number.
        word: of its bits.
        fused: whether a b + c is rounded once. If not, the parts of constants are short, so that
            their products with whole numbers are exact.
        mantissa: bits of it.
        bias: of the exponent.
        half: bits of sqrt(1/2).
        far: largest argument of sine, cosine and tangent.
        quarter: pi / 2 in three parts.
        sin: (sin r - r) / r^3 by powers of r^2, |r| <= 1.005 pi/4; weight 1 / sin.
        cos: (cos r - 1 + r^2 / 2) / r^4 by powers of r^2, |r| <= 1.005 pi/4; weight 1 / cos.
        most, least: arguments of exp beyond which it is infinite, or 0.
        log2: log 2 in two parts.
        exp: (e^r - 1 - r) / r^2 by powers of r, |r| <= log(2) / 2; weight r.
        log2_short: the same parts, the first of them short.
        log: (2 artanh(s) / s - 2) / s^2 by powers of s^2, s = f / (2 + f), sqrt(1/2) <= 1 + f <
            sqrt(2); weight s^2.
        certain: where erf rounds to 1.
        head: 2 / sqrt(pi), with the first of `erf`.
        erf: -log(1 - erf a) / a - head by powers of a in [0, certain]; weight
            a (1 - erf a) / erf a.
        atan: (atan(x) / x - 1) / x^2 by powers of x^2, |x| <= tan(pi / 8).
        pi4, pi2: pi / 4 and pi / 2, each as a number and its rest.
    """

    kind: str
    word: str
    fused: bool
    mantissa: int
    bias: int
    half: int
    far: float
    quarter: tuple[float, float, float]
    sin: tuple[float, ...]
    cos: tuple[float, ...]
    most: float
    least: float
    log2: tuple[float, float]
    exp: tuple[float, ...]
    log2_short: tuple[float, float]
    log: tuple[float, ...]
    certain: float
    head: float
    erf: tuple[float, ...]
    atan: tuple[float, ...]
    pi4: tuple[float, float]
    pi2: tuple[float, float]

    @property
    def bits(self) -> int:
        """Bits of a word."""
        return int(self.word[4:])

    @property
    def sign(self) -> int:
        """The bit of a sign."""
        return 1 << (self.bits - 1)

    @property
    def one(self) -> int:
        """The bits of 1."""
        return self.bias << self.mantissa

    @property
    def largest(self) -> float:
        """The largest finite number."""
        return (2.0 - 0.5**self.mantissa) * 2.0**self.bias

    @property
    def whole(self) -> float:
        """2^mantissa, from where on numbers have no fraction."""
        return 2.0**self.mantissa

    @property
    def shift(self) -> float:
        """A number to which another one is added becomes whole, in the last bits of the sum."""
        return 1.5 * self.whole


# 2^-58 for sin, 2^-64 for cos, 2^-61 for exp, 2^-58 for log, 2^-57 for erf.
DOUBLE: Final = Numbers(
    kind="float64",
    word="uint64",
    fused=False,
    mantissa=52,
    bias=1023,
    half=0x3FE6A09E667F3BCD,
    far=1e5,
    quarter=(1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21),
    sin=(
        -0.1666666666666663,
        0.008333333333321867,
        -0.00019841269829351657,
        2.7557313527695806e-06,
        -2.505073154586686e-08,
        1.5895209746055687e-10,
    ),
    cos=(
        0.041666666666666595,
        -0.0013888888888873385,
        2.480158728900059e-05,
        -2.7557314207741605e-07,
        2.0875702934427074e-09,
        -1.135856184094998e-11,
    ),
    most=750.0,
    least=-750.0,
    log2=(0.6931471805598903, 5.497923018708371e-14),
    exp=(
        0.5,
        0.16666666666666677,
        0.0416666666666667,
        0.008333333333321617,
        0.0013888888888866694,
        0.00019841269886157698,
        2.4801587360795128e-05,
        2.755724418270308e-06,
        2.755724258742789e-07,
        2.5109044640515566e-08,
        2.0924488510003118e-09,
    ),
    log2_short=(0.6931471805598903, 5.497923018708371e-14),
    log=(
        0.6666666666666734,
        0.3999999999941394,
        0.2857142874256638,
        0.22222198553420341,
        0.1818356542424928,
        0.15314020709753456,
        0.14796265152338745,
    ),
    certain=5.93,
    head=1.1283791670955126,
    erf=(
        9.76117611312222e-18,
        0.6366197723675836,
        0.10277260330178874,
        -0.019128447005068803,
        -0.00020919469486840712,
        0.001696206385974935,
        -0.0005901255541723382,
        2.5878609143621217e-05,
        6.449184749408079e-05,
        -2.9724018709271747e-05,
        3.407222134222892e-06,
        2.8351939834190592e-06,
        -1.7416005899555316e-06,
        3.3640688952601167e-07,
        1.3715495743723908e-07,
        -1.417478513980929e-07,
        6.572760629362529e-08,
        -2.0960695130725553e-08,
        4.997190901466319e-09,
        -9.081181835126703e-10,
        1.248248513746862e-10,
        -1.2609178042862588e-11,
        8.844158337298547e-13,
        -3.8498487535343996e-14,
        7.832682749273684e-16,
    ),
    atan=(
        -0.33333333333333304,
        0.19999999999984602,
        -0.14285714283376835,
        0.1111111094693837,
        -0.09090902661959809,
        0.07692153096600197,
        -0.06664260722067589,
        0.05857502401616057,
        -0.05092147301219989,
        0.039910338291914406,
        -0.021620254100164805,
        0.003277577170168969,
    ),
    pi4=(0.7853981633974483, 3.061616997868383e-17),
    pi2=(1.5707963267948966, 6.123233995736766e-17),
)

FUSED: Final = DOUBLE._replace(
    fused=True,
    far=2.0**45,
    quarter=(1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33),
    log2=(0.6931471805599453, 2.3190468138462996e-17),
)

SINGLE: Final = Numbers(
    kind="float32",
    word="uint32",
    fused=False,
    mantissa=23,
    bias=127,
    half=0x3F3504F3,
    far=8000.0,
    quarter=(1.5703125, 4.837512969970703e-4, 7.54978995489188e-8),
    sin=(-0.16666664542406717, 0.008332725000087459, -0.0001958289205437704),
    cos=(0.041666664538856854, -0.0013888279652855464, 2.4542922323138213e-05),
    most=89.0,
    least=-104.0,
    log2=(0.693359375, -2.12194440e-4),
    exp=(
        0.500000001429109,
        0.16666666722230075,
        0.04166645677791302,
        0.008333297063830462,
        0.001393454452077215,
        0.00019900443813615233,
    ),
    log2_short=(0.693359375, -2.12194440e-4),
    log=(0.6666666654423972, 0.4000012995369697, 0.28549921167284736, 0.23354497929544507),
    certain=3.95,
    head=1.1283792,
    erf=(
        -5.411580765591796e-08,
        0.6366193818640916,
        0.10277783130059416,
        -0.01915306656058255,
        -0.00016039150197556768,
        0.0016670231584434978,
        -0.0006328346155574801,
        0.00011764067074975209,
        -9.2562006904206e-06,
    ),
    atan=(
        -0.3333333174149294,
        0.19999533391210308,
        -0.1426365199717305,
        0.10740013674856196,
        -0.06438549020919085,
    ),
    pi4=(0.785398185253143310546875, -2.18556950e-8),
    pi2=(1.57079637050628662109375, -4.37113900e-8),
)
