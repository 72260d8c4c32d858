"""The houses of two storeys, under the name that the tests know."""

from gpdf_service.synthetic.house import House as House
from gpdf_service.synthetic.house import make_house as make_house
