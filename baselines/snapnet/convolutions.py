"""Blocks of 3-D convolutions, exact but cheaper than their plain forms.

B batch, C channels, x y z the sizes of a volume; tensors of features are (B, C, x, y, z). Only ops of torch are used:
every device runs the same code.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from scipy.fft import next_fast_len
from torch import Tensor, nn

Span = tuple[int, int]
"""First index and the one after the last, along an axis."""
Region = tuple[Span, Span, Span]

SLAB = 2**21
"""Voxels of a volume above which its full resolution is processed in slabs: the features of one stay in the cache."""
SLAB_ROWS = 4
"""Rows of a slab, at half the resolution: few stay in the cache; torch has a slow convolution for even fewer."""

# Nearest x2 upsampling followed by a kernel of 3 is one transposed convolution, stride 2, with a kernel of 4: fine
# cell 2i + j (j = 0, 1) holds coarse cell i, and tap t takes it to 2i + j - t + 1, tap j - t + 2 of the four.
FOLD = ((0, 0, 1), (0, 1, 1), (1, 1, 0), (1, 0, 0))


class UpsampleConcatConv(nn.Conv3d):
    """A 3x3x3 convolution, zero-padded, of fine features concatenated with coarse ones, upsampled x2 to the nearest.

    Weights and output are those of `Conv3d(fine + coarse, out, 3, padding=1)` on the concatenated channels, which are
    never made; a coarse channel takes 8 products an output where the plain form takes 27.
    """

    def __init__(self, fine: int, coarse: int, out: int) -> None:
        super().__init__(fine + coarse, out, 3, padding=1)
        self.fine = fine

    def forward(self, fine: Tensor, coarse: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """(B, fine, 2x, 2y, 2z) and (B, coarse, x, y, z) -> (B, out, 2x, 2y, 2z)."""
        own, upsampled = self.weight[:, : self.fine], self.weight[:, self.fine :]
        up = F.conv_transpose3d(coarse, folded(upsampled), stride=2, padding=1)
        return F.conv3d(fine, own, self.bias, padding=1).add_(up)


def folded(weight: Tensor) -> Tensor:
    """(out, in, 3, 3, 3) for an upsampled volume -> (in, out, 4, 4, 4) for a transposed convolution of the volume."""
    fold = weight.new_tensor(FOLD)
    return torch.einsum("oitru,at,br,cu->ioabc", weight, fold, fold, fold)


class SingleChannelConv(nn.Conv3d):
    """A 3x3x3 convolution of one channel, zero-padded, as 2-D convolutions of images whose 3 channels are along x.

    Weights and output are those of `Conv3d(1, out, 3, padding=1)`; the output is channels-last in memory, and so are
    then the outputs of all further layers, which is fastest on CPUs.
    """

    def __init__(self, out: int) -> None:
        super().__init__(1, out, 3, padding=1)

    def forward(self, input: Tensor) -> Tensor:
        """(B, 1, x, y, z) -> (B, out, x, y, z)."""
        return self.rows(F.pad(input[:, 0], (0, 0, 0, 0, 1, 1)))

    def rows(self, padded: Tensor) -> Tensor:
        """(B, x + 2, y, z) -> (B, out, x, y, z), for rows whose neighbours along x are given."""
        count = padded.shape[1] - 2
        images = padded.unfold(1, 3, 1).flatten(0, 1).permute(0, 3, 1, 2)  # (B x, 3, y, z), channels last
        flat = F.conv2d(images, self.weight[:, 0].contiguous(memory_format=torch.channels_last), self.bias, padding=1)
        return flat.unflatten(0, (-1, count)).transpose(1, 2)  # (B, out, x, y, z)


def downsampled(first: SingleChannelConv, second: nn.Conv3d, volume: Tensor) -> Tensor:
    """Two convolutions with ReLU, the second of stride 2: (B, 1, x, y, z) -> (B, C, x/2, y/2, z/2).

    Large volumes are processed in slabs, so that the features at full resolution are never in memory at once.
    """
    if volume.shape[-3:].numel() <= SLAB:
        return F.relu_(second(F.relu_(first(volume))))
    halves = volume.shape[2] // 2
    padded = F.pad(volume[:, 0], (0, 0, 0, 0, 1, 1))
    slabs = [_slab(first, second, padded, (a, min(a + SLAB_ROWS, halves))) for a in range(0, halves, SLAB_ROWS)]
    return torch.cat(slabs, dim=2)


def _slab(first: SingleChannelConv, second: nn.Conv3d, padded: Tensor, rows: Span) -> Tensor:
    """Rows of `downsampled`, from a volume padded by one along x: they depend on fine rows 2a - 1 to 2b - 1."""
    a, b = max(2 * rows[0] - 1, 0), 2 * rows[1]
    fine = F.relu_(first.rows(padded[:, a : b + 2]))
    if rows[0] == 0:
        fine = F.pad(
            fine, (0, 0, 0, 0, 1, 0)
        )  # the padding of the second convolution is zero, not the first's output for zeros
    return F.relu_(F.conv3d(fine, second.weight, second.bias, stride=2, padding=(0, 1, 1)))


def coarser(region: Region, sizes: tuple[int, ...]) -> Region:
    """The coarse cells that an `UpsampleConcatConv` needs for a region of its output; sizes: of the coarse volume."""
    spans = [(max((a - 1) // 2, 0), min((b + 2) // 2, n)) for (a, b), n in zip(region, sizes, strict=True)]
    return spans[0], spans[1], spans[2]


def finer(region: Region) -> Region:
    """The same region in cells half as large."""
    spans = [(2 * a, 2 * b) for a, b in region]
    return spans[0], spans[1], spans[2]


def relative(inner: Region, outer: Region) -> Region:
    """The inner region, counted from the outer one's first cell."""
    spans = [(a - low, b - low) for (a, b), (low, _) in zip(inner, outer, strict=True)]
    return spans[0], spans[1], spans[2]


def cropped(features: Tensor, region: Region) -> Tensor:
    """(B, C, x, y, z) -> the features of the region, a view."""
    (a, b), (c, d), (e, f) = region
    return features[:, :, a:b, c:d, e:f]


def correlate(part: Tensor, kit: Tensor, window: tuple[int, int, int]) -> Tensor:
    """Valid cross-correlation, summed over the channels, by Fourier transforms.

    The mean of each channel of `kit` over its volume is subtracted first: this shifts all sums of a sample alike,
    which a softmax ignores, and keeps the differences between positions within the precision of float32.

    Args:
        part: (B, C, p, q, r), the template.
        kit: (B, C, x, y, z), at least p + window - 1 along each axis.
        window: positions along each axis.

    Returns:
        (B, *window): at cell c the sum over channels and k of part[k] (kit[c + k] - mean).
    """
    wide = torch.promote_types(part.dtype, torch.float32)  # transforms do not support bfloat16
    part, kit = part.to(wide), kit.to(wide)
    kit = kit - kit.mean(dim=(2, 3, 4), keepdim=True)
    axes = (2, 3, 4)
    sizes = [
        next_fast_len(size, real=True) for size in kit.shape[2:]
    ]  # sums that wrap around come after the valid ones
    product = torch.fft.rfftn(part, s=sizes, dim=axes).conj() * torch.fft.rfftn(kit, s=sizes, dim=axes)
    sums = torch.fft.irfftn(product.sum(dim=1), s=sizes, dim=(1, 2, 3))
    return sums[:, : window[0], : window[1], : window[2]]
