"""Networks for a set of targets, independent of the order of the rows and of padding.

The satellite's features and every target are tokens that attend to each other. A target's token yields the logit of its image,
and the satellite's token the logits of the other actions and the value of the state.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import relu, scaled_dot_product_attention

LEAST = -1e4
"""Logit of images of padding; finite, because there may be no other choice."""


class Block(nn.Module):
    """Self-attention and a feed-forward layer, both with a residual connection and pre-normalization (Xiong et al. 2020)."""

    def __init__(self, width: int, heads: int) -> None:
        """Build for tokens of ``width`` features, a multiple of the number of heads."""
        super().__init__()
        self.heads = heads
        self.norm, self.queries_keys_values, self.joined = (
            nn.LayerNorm(width),
            nn.Linear(width, 3 * width),
            nn.Linear(width, width),
        )
        self.forward_norm, self.wide, self.narrow = nn.LayerNorm(width), nn.Linear(width, width), nn.Linear(width, width)

    def forward(self, tokens: Tensor, exists: Tensor) -> Tensor:
        """Return the tokens [B, T, W] after attention to the existing ones, ``exists`` [B, T] booleans."""
        parts = self.queries_keys_values(self.norm(tokens)).unflatten(-1, (3, self.heads, -1))
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        attended = scaled_dot_product_attention(query, key, value, attn_mask=exists[:, None, None, :])
        tokens = tokens + self.joined(attended.transpose(1, 2).flatten(-2))
        return tokens + self.narrow(relu(self.wide(self.forward_norm(tokens))))


class Encoder(nn.Module):
    """Computes the tokens of the satellite, which is first, and of every target."""

    def __init__(self, n_own: int, n_features: int, width: int, heads: int, blocks: int) -> None:
        """Expect ``n_own`` numbers of the satellite and ``n_features`` of each target."""
        super().__init__()
        self.own, self.context, self.row = nn.Linear(n_own, width), nn.Linear(n_own, width), nn.Linear(n_features, width)
        self.mix = nn.Linear(width, width)
        self.blocks = nn.ModuleList(Block(width, heads) for _ in range(blocks))
        self.norm = nn.LayerNorm(width)

    def forward(self, satellite: Tensor, rows: Tensor, mask: Tensor) -> Tensor:
        """Return the tokens [B, 1 + K, W] of ``satellite`` [B, D] and ``rows`` [B, K, F], with existing rows ``mask`` [B, K]."""
        targets = self.mix(relu(self.row(rows) + self.context(satellite).unsqueeze(-2)))
        tokens = torch.cat([self.own(satellite).unsqueeze(-2), targets], -2)
        exists = torch.cat([torch.ones_like(mask[:, :1]), mask], -1)
        for block in self.blocks:
            tokens = block(tokens, exists)
        return self.norm(tokens)


class SetActor(nn.Module):
    """Computes the logits of all actions: of images from the tokens of their targets, of others from the satellite's token.

    The number of images need not be that of the training: it is the number of the action mask's columns without other actions.
    """

    def __init__(self, encoder: Encoder, width: int, n_actions: int, images: range, scale: float) -> None:
        """Build for ``n_actions`` actions, of which ``images`` image the first targets.

        Initial logits are of the order of ``scale``.
        """
        super().__init__()
        self.encoder, self.first, self.n_others = encoder, images.start, n_actions - len(images)
        self.image = nn.utils.skip_init(nn.Linear, width, 1)
        self.other = nn.utils.skip_init(nn.Linear, width, self.n_others) if self.n_others else None
        with torch.no_grad():
            for layer in filter(None, (self.image, self.other)):
                layer.weight.normal_(0.0, scale * width**-0.5)
                layer.bias.zero_()

    def forward(self, satellite: Tensor, rows: Tensor, mask: Tensor, legal: Tensor) -> Tensor:
        """Return logits [..., A] of the actions with the mask ``legal`` [..., A]; for the others, see :meth:`Encoder.forward`."""
        batch, n_images = satellite.shape[:-1], legal.shape[-1] - self.n_others
        satellite, rows, mask = satellite.flatten(0, -2), rows.flatten(0, -3), mask.flatten(0, -2)
        tokens = self.encoder(satellite, rows, mask)
        images = self.image(tokens[:, 1 : 1 + n_images]).squeeze(-1)
        images = images.masked_fill(~mask[:, :n_images], LEAST)
        scores = tokens[:, 0, :0] if self.other is None else self.other(tokens[:, 0])
        logits = torch.cat([scores[:, : self.first], images, scores[:, self.first :]], -1)
        return logits.view(*batch, -1)


class SetCritic(nn.Module):
    """Computes the value of a state from the satellite's token and the mean of the targets' tokens."""

    def __init__(self, encoder: Encoder, width: int) -> None:
        """Build on the tokens of ``encoder``."""
        super().__init__()
        self.encoder = encoder
        self.value = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, satellite: Tensor, rows: Tensor, mask: Tensor) -> Tensor:
        """Return the value [..., 1]; for the arguments, with any leading dimensions, see :meth:`Encoder.forward`."""
        batch = satellite.shape[:-1]
        satellite, rows, mask = satellite.flatten(0, -2), rows.flatten(0, -3), mask.flatten(0, -2)
        tokens = self.encoder(satellite, rows, mask)
        return self.value(torch.cat([tokens[:, 0], mean_where(tokens[:, 1:], mask)], -1)).view(*batch, 1)


def mean_where(x: Tensor, mask: Tensor) -> Tensor:
    """Mean [..., W] of those x [..., K, W] where ``mask`` [..., K] is true; zero if there are none."""
    weight = mask.unsqueeze(-1).to(x.dtype)
    return (x * weight).sum(-2) / weight.sum(-2).clamp(min=1.0)
