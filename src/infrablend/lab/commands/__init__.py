"""Commands of the lab. `cli.app.COMMANDS` names them."""
