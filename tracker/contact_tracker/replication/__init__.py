"""The experiments of the paper (its section IV) on simulated recordings, and the tracker on the same poses.

The paper moved a real cube by hand and measured it by motion capture. Here both are simulated: the same
contacts, durations and rate, with white noise and with low-pass-filtered noise.
"""

from contact_tracker.replication.contact_sequence import ContactSequence, replicate_sequence
from contact_tracker.replication.noises import NOISES
from contact_tracker.replication.single_contact import MOVED, SingleContact, replicate_contact

__all__ = ["MOVED", "NOISES", "ContactSequence", "SingleContact", "replicate_contact", "replicate_sequence"]
