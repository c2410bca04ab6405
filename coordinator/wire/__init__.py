"""How the coordinator is spoken to: sessions and rights, the front desk, the meaning of each verb."""
