# SPDX-License-Identifier: Apache-2.0
"""Training of the event network on simulated flights; nothing else needs what is here."""
