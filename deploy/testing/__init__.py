"""Fleets for tests of a mission, a law or a robot's driver: rehearsed in memory, or as real processes.

Both have the same methods. With pytest the fixtures `rehearsed_fleet` and `process_fleet` make them:

    def test_mission_goes_on_without_a_robot(rehearsed_fleet):
        fleet = rehearsed_fleet("six_robots", seed=1)
        fleet.run_until_settled()
        fleet.kill("robot5")
        fleet.run(10.0)
        assert fleet.state("robot2") == "run"
"""
