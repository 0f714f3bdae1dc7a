from .export import write_as as write_as
from .fiducials import FiducialsDocument as FiducialsDocument, read_fiducials as read_fiducials
from .plan import read_plan as read_plan, write_plan as write_plan
from .registration import RegistrationDocument as RegistrationDocument, read_registration as read_registration
from .results import write_fiducials as write_fiducials, write_registration as write_registration
from .template import read_template as read_template
