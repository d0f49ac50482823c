"""Telemetry for other ground systems (Yamcs, Open MCT, ...): CCSDS space packets and their XTCE database.

packets: LCM messages as CCSDS packets. database: XTCE 1.2 that describes them. bridge: from LCM to UDP."""
