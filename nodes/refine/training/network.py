"""The networks: U-Nets of NAF blocks with CBAM. The refinement's output is a change of its input that is nothing where no event is near; the interpolator's is a picture
between two captured frames.

The refinement: Jiang et al., CVPR 2024, section 4.2. The interpolator is ours, in the manner of Time Lens (Tulyakov et al., CVPR 2021). NAF blocks: Chen et al., Simple Baselines for Image Restoration, ECCV 2022. CBAM: Woo et al., ECCV 2018.

Differences, and why:
- At full size there are two plain convolutions and no block: blocks begin at half size, where they have a quarter of the pixels.
- Attention over channels looks at cells of 16 x 16 pixels of the frame and not at all of it, so that a tile of a frame gives what the whole frame does.
- It works on square roots of light, where noise is the same in bright and dark, and changes them.
- The last layer begins at zero; in the refinement a gate multiplies what it gives: exactly zero further than 5 pixels from any event.
"""

import torch
from torch import nn
from torch.nn import functional as F

LEAST = 1e-4  # share of white; keeps the square root from having an infinite slope at black
CELL = 16  # pixels of the frame along a side of what attention over channels looks at


class LayerNorm(nn.Module):
    """Over channels, for each pixel."""

    def __init__(self, channels):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(1, channels, 1, 1))
        self.shift = nn.Parameter(torch.zeros(1, channels, 1, 1))

    def forward(self, x):
        x = x - x.mean(1, keepdim=True)
        return x / torch.sqrt((x * x).mean(1, keepdim=True) + 1e-6) * self.scale + self.shift


def gate(x):
    """NAFNet's SimpleGate: half of the channels times the other half."""
    a, b = x.chunk(2, 1)
    return a * b


class ChannelAttention(nn.Module):
    """CBAM's attention over channels, or NAFNet's, in cells of the frame."""

    def __init__(self, channels, level, cbam):
        super().__init__()
        self.cell, self.cbam = CELL >> level, cbam
        if cbam:
            few = max(4, channels // 4)
            self.weigh = nn.Sequential(nn.Conv2d(channels, few, 1), nn.ReLU(), nn.Conv2d(few, channels, 1))
        else:
            self.weigh = nn.Conv2d(channels, channels, 1)

    def forward(self, x):
        mean = self.weigh(F.avg_pool2d(x, self.cell))
        weight = torch.sigmoid(mean + self.weigh(F.max_pool2d(x, self.cell))) if self.cbam else mean
        return x * F.interpolate(weight, scale_factor=float(self.cell), mode="bilinear", align_corners=False)


class SpatialAttention(nn.Module):
    """CBAM's attention over places."""

    def __init__(self):
        super().__init__()
        self.conv = nn.Conv2d(2, 1, 7, padding=3)

    def forward(self, x):
        return x * torch.sigmoid(self.conv(torch.cat([x.mean(1, keepdim=True), x.amax(1, keepdim=True)], 1)))


class Block(nn.Module):
    """A NAF block; with CBAM, its attention is over channels and then over places."""

    def __init__(self, channels, level, cbam):
        super().__init__()
        c = channels
        self.norm_1, self.norm_2 = LayerNorm(c), LayerNorm(c)
        self.wide, self.depth, self.narrow = nn.Conv2d(c, 2 * c, 1), nn.Conv2d(2 * c, 2 * c, 3, padding=1, groups=2 * c), nn.Conv2d(c, c, 1)
        self.channel = ChannelAttention(c, level, cbam)
        self.spatial = SpatialAttention() if cbam else nn.Identity()
        self.more, self.less = nn.Conv2d(c, 2 * c, 1), nn.Conv2d(c, c, 1)
        self.share_1, self.share_2 = nn.Parameter(torch.full((1, c, 1, 1), 0.3)), nn.Parameter(torch.full((1, c, 1, 1), 0.3))

    def forward(self, x):
        y = gate(self.depth(self.wide(self.norm_1(x))))
        x = x + self.share_1 * self.narrow(self.spatial(self.channel(y)))
        return x + self.share_2 * self.less(gate(self.more(self.norm_2(x))))


class UNet(nn.Module):
    """What both networks are made of; the last layer begins at zero."""

    def __init__(self, inputs, outputs, width=32, cbam=True, blocks=(2, 3, 2)):
        super().__init__()
        w = width

        def level(count, channels, number):
            return nn.Sequential(*(Block(channels, number, cbam) for _ in range(count)))

        self.first = nn.Conv2d(inputs, w, 3, padding=1)
        self.down = nn.ModuleList([nn.Conv2d(w, 2 * w, 2, stride=2), nn.Conv2d(2 * w, 4 * w, 2, stride=2)])
        self.enter, self.middle, self.leave = level(blocks[0], 2 * w, 1), level(blocks[1], 4 * w, 2), level(blocks[2], 2 * w, 1)
        self.up = nn.ModuleList([nn.ConvTranspose2d(4 * w, 2 * w, 2, stride=2), nn.ConvTranspose2d(2 * w, w, 2, stride=2)])
        self.join = nn.Conv2d(w, w, 3, padding=1)
        self.last = nn.Conv2d(w, outputs, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def changes(self, x):
        a = self.first(x)
        b = self.enter(self.down[0](a))
        b = self.leave(self.up[0](self.middle(self.down[1](b))) + b)
        return self.last(F.relu(self.join(F.relu(self.up[1](b) + a))))


def root(light):
    return torch.sqrt(torch.clamp(light, min=0.0) + LEAST)


class Refinement(UNet):
    """`frame`, `sigma` and `captured` are shares of white [1, 1, h, w], `events` counts near the instant [1, 2, h, w]; gives the frame once more.

    Zeros stand for a `sigma` or `captured` that is not there. Height and width are multiples of 16.
    """

    INPUTS = {"frame": 1, "sigma": 1, "events": 2, "captured": 1}  # channels
    OUTPUT = "refined"

    def __init__(self, width=32, cbam=True, blocks=(2, 3, 2)):
        super().__init__(6, 1, width, cbam, blocks)

    @staticmethod
    def given(frame, *_):
        """What is there without the network."""
        return frame

    def forward(self, frame, sigma, events, captured):
        now, before = root(frame), root(captured)
        # The standard deviation of a square root, and events by their order of magnitude.
        spread = torch.clamp(sigma / (2.0 * now), max=1.0)
        change = self.changes(torch.cat([now, 10.0 * spread, torch.log1p(events), before, 3.0 * (before - now)], 1))
        # Never below black: the change of the root is at least what is left of it.
        near = F.avg_pool2d(F.max_pool2d(events.sum(1, keepdim=True), 7, 1, 3), 5, 1, 2)
        change = torch.maximum(change, -now) * (1.0 - torch.exp(-2.0 * near))
        return frame + change * (2.0 * now + change)


class Interpolator(UNet):
    """The picture at an instant between two captured frames, from them and the events around it.

    `before` and `after` are shares of white [1, 1, h, w], the others voxel grids [1, bins, h, w] with ON 1 and OFF -1, and `weight` [1, 1, 1, 1] is the instant's place
    between the frames' middles. Each frame is carried to the instant by its events, one step each, then changed by a factor that is learned; a learned share
    chooses between the two, and a last learned part is added. Height and width are multiples of 16.
    """

    # Name of the input: the window of its events (nodes/baseline/onnx/layout.rs), and bins.
    VOXELS = {"voxel_before": ("before_to_instant", 5), "voxel_after": ("instant_to_after", 5), "voxel_exposures": ("exposures", 16)}
    INPUTS = {"before": 1, "after": 1, **{name: bins for name, (_, bins) in VOXELS.items()}, "weight": 0}  # channels; 0 = one number
    OUTPUT = "picture"

    def __init__(self, width=32, cbam=True, blocks=(2, 3, 2)):
        super().__init__(5 + sum(bins for _, bins in self.VOXELS.values()), 4, width, cbam, blocks)
        self.step = nn.Parameter(torch.tensor(0.1))  # of a root's logarithm: half of a threshold

    @staticmethod
    def given(before, after, *others):
        """The frames blended, which is there without the network and without events."""
        weight = others[-1]
        return (root(before) * (1.0 - weight) + root(after) * weight) ** 2 - LEAST

    def forward(self, before, after, voxel_before, voxel_after, voxel_exposures, weight):
        one, other = root(before), root(after)
        one_there = one * torch.exp(torch.clamp(self.step * voxel_before.sum(1, keepdim=True), -3.0, 3.0))
        other_there = other * torch.exp(torch.clamp(-self.step * voxel_after.sum(1, keepdim=True), -3.0, 3.0))
        place = 0.0 * before + weight
        grids = 0.3 * torch.cat([voxel_before, voxel_after, voxel_exposures], 1)
        change = self.changes(torch.cat([one, other, one_there, other_there, place, grids], 1))
        one_there = one_there * torch.exp(torch.clamp(change[:, 0:1], -2.0, 2.0))
        other_there = other_there * torch.exp(torch.clamp(change[:, 1:2], -2.0, 2.0))
        share = torch.sigmoid(change[:, 2:3] + 4.0 * (place - 0.5))
        now = torch.clamp(one_there + (other_there - one_there) * share + change[:, 3:4], 0.0, 1.5)
        return now * now - LEAST
